"""Relative engagement: the tool starts where it is, and follows the changes of the hand in position and orientation.

The virtual Leap is turned to the hand's heading, as in any stream, and shifted such that the palm is at the tool. The
tool turns with the hand about the same axes in space. Yaw, pitch and roll of the hand count from its orientation at the
start, about its own axes then; each is clipped, so a level hand need not mean a tool that points down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import check_pose, pose, read_only
from common.rotations import rotation_from_zyx
from leap_kuka.virtual_leap import R_LEAP_REFERENCE, Attitude


@dataclass(frozen=True)
class RelativeMotion:
    """What a relative stream starts from."""

    T_base_virtual: np.ndarray  # pose of the virtual Leap, shape (4, 4) [m]
    R_leap_start: np.ndarray  # orientation of the hand at the start, shape (3, 3)
    R_virtual_start: np.ndarray  # orientation of the tool at the start, shape (3, 3)

    def change(self, R_leap_hand: np.ndarray) -> np.ndarray:
        """Returns the orientation, shape (3, 3), whose attitude at heading 0 is the change of the hand's since."""
        return R_LEAP_REFERENCE @ self.R_leap_start.T @ R_leap_hand

    def rotation(self, change: Attitude) -> np.ndarray:
        """Returns R_virtual_tool, shape (3, 3), for a change of the hand's attitude."""
        return self.R_leap_start @ rotation_from_zyx(*change.angles) @ self.R_leap_start.T @ self.R_virtual_start


def relative_motion(T_base_tool: np.ndarray, R_base_virtual: np.ndarray, T_leap_hand: np.ndarray) -> RelativeMotion:
    """Returns the motion that starts with the desired tool at a pose and the hand at another, shapes (4, 4) [m].

    `R_base_virtual` is the orientation of the virtual Leap, shape (3, 3).
    """
    p = T_base_tool[:3, 3] - R_base_virtual @ T_leap_hand[:3, 3]
    R_virtual_tool = R_base_virtual.T @ T_base_tool[:3, :3]
    return RelativeMotion(read_only(pose(R_base_virtual, p)), T_leap_hand[:3, :3], read_only(R_virtual_tool))


def unscaled(T_base_tool: np.ndarray, ws_center: np.ndarray, scale: float) -> np.ndarray:
    """Returns the desired tool, shape (4, 4) [m], that the controller scales to the given one.

    Its positions count from the centre of the workspace, shape (3,) [m]. Raises ValueError for a pose that is none, or
    a scaling factor that is not above 0.
    """
    check_pose(T_base_tool)
    if not 0.0 < scale < np.inf:
        raise ValueError(f"the controller's scaling factor is {scale:g}")
    return read_only(pose(T_base_tool[:3, :3], ws_center + (T_base_tool[:3, 3] - ws_center) / scale))
