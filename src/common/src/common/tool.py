"""The tool on the arm's flange, as the parameters under `kuka/` describe it.

Most tools are a length along the flange's z axis. A rotated or offset tool is given as a whole pose instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from common.config import flag, number, vector
from common.poses import check_pose, read_only, translation

MAX_TOOL_M = 1.0  # a tool point farther from the flange is probably given in millimetres


@dataclass(frozen=True)
class ToolConfig:
    """The parameters of the tool."""

    tool_length: float = number("m", low=0.0, doc="from the flange to the tool point, along the flange's z axis")
    tool_transform: np.ndarray = vector(
        16, absent=np.eye(4).ravel(), doc="pose of the tool in the flange, 4 x 4 row by row, lengths in m"
    )
    use_tool_transform: bool = flag(
        absent=False, doc="whether tool_transform describes the tool instead of tool_length"
    )

    def faults(self) -> list[str]:
        """Returns the faults that no single parameter can show, one sentence each."""
        if not self.use_tool_transform:
            return []
        try:
            point = check_pose(self.tool_transform.reshape(4, 4))[:3, 3]
        except ValueError as error:
            return [
                f"tool_transform is not a pose: {error}; give a rotation without scale or reflection, with at least "
                "seven digits, and a position in m."
            ]
        if np.linalg.norm(point) <= MAX_TOOL_M:
            return []
        return [
            f"tool_transform has its tool point at {point.tolist()} m, farther than {MAX_TOOL_M:g} m from the flange; "
            "give metres."
        ]

    @cached_property
    def T_flange_tool(self) -> np.ndarray:
        """Pose of the tool in the flange, shape (4, 4) [m]."""
        if self.use_tool_transform:
            return read_only(self.tool_transform.reshape(4, 4))
        return read_only(translation(0.0, 0.0, self.tool_length))
