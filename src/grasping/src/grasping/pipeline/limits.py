"""The limits that a published grasp keeps: near enough, inside the usable space, and no wider than the hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import number, vector


@dataclass(frozen=True)
class LimitsConfig:
    """Limits of a grasp."""

    nearest: float = number("m", low=0.0, high=10.0, doc="least depth of a grasp before the camera")
    farthest: float = number("m", above=0.0, high=10.0, doc="largest depth")
    x: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest x in kuka/base_frame")
    y: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest y")
    z: np.ndarray = vector(2, "m", low=-5.0, high=5.0, doc="least and largest z")

    def faults(self) -> list[str]:
        """Names what no single field can check."""
        faults = [
            f"{name} is {list(getattr(self, name))}, but the least must be below the largest."
            for name in "xyz"
            if getattr(self, name)[0] >= getattr(self, name)[1]
        ]
        if self.nearest >= self.farthest:
            faults.append(f"nearest is {self.nearest:g} m, but must be below farthest, {self.farthest:g} m.")
        return faults


def rejection_reason(
    T_camera_grasp: np.ndarray, T_base_grasp: np.ndarray | None, width: float, opening: float, limits: LimitsConfig
) -> str:
    """Returns why a grasp is rejected, a clause about the grasp; empty if it is accepted.

    Args:
        T_camera_grasp: shape (4, 4) [m].
        T_base_grasp: in kuka/base_frame; None where that is unknown, and not checked then.
        width: opening that the grasp needs [m].
        opening: widest of the hand [m].
    """
    depth = T_camera_grasp[2, 3]
    if not limits.nearest <= depth <= limits.farthest:
        allowed = f"{limits.nearest:.2f} to {limits.farthest:.2f} m"
        return f"it is {depth:.2f} m before the camera, and {allowed} are allowed"
    if width > opening:
        return f"it needs an opening of {1e3 * width:.0f} mm, and the hand has {1e3 * opening:.0f} mm"
    if T_base_grasp is None:
        return ""
    for name, value in zip("xyz", T_base_grasp[:3, 3]):
        low, high = getattr(limits, name)
        if not low <= value <= high:
            return f"its {name} is {value:.2f} m in the base frame, and {low:.2f} to {high:.2f} m are allowed"
    return ""
