"""How the controller scales a desired tool: about the workspace's centre, and by an offset once the factor changed."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from common.poses import check_pose, pose, read_only

NO_OFFSET = read_only(np.zeros(3))


@dataclass(frozen=True)
class Scaling:
    """The controller's scaling; vectors have shape (3,) [m]."""

    centre: np.ndarray
    factor: float = 1.0
    offset: np.ndarray = field(default_factory=lambda: NO_OFFSET)

    @property
    def fault(self) -> str | None:
        if 0.0 < self.factor < math.inf and bool(np.all(np.isfinite(self.offset))):
            return None
        return f"the controller's scaling factor is {self.factor:g}, with the offset {self.offset.tolist()} m"

    def scaled(self, position: np.ndarray) -> np.ndarray:
        """Returns where a desired position, shape (3,), brings the tool; one without a valid factor where it is."""
        if self.fault:
            return position
        return self.centre + self.factor * (position - self.centre) + self.offset

    def unscaled(self, T_base_tool: np.ndarray) -> np.ndarray:
        """Returns the desired tool that the controller scales to the given one, shapes (4, 4); ValueError: not a
        pose, or an invalid factor."""
        check_pose(T_base_tool)
        if self.fault:
            raise ValueError(self.fault)
        p = self.centre + (T_base_tool[:3, 3] - self.offset - self.centre) / self.factor
        return read_only(pose(T_base_tool[:3, :3], p))
