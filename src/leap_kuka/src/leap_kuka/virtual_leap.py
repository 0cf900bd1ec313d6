"""The pose of the virtual Leap in the robot's base frame.

The virtual Leap stands upright in the world, below the centre of the workspace. It is turned about its vertical axis so
that one horizontal direction of the real Leap frame, the heading, points forward: along the centre line.

A heading is the angle psi [rad] of a horizontal direction (sin psi, 0, -cos psi) in the Leap frame: 0 points along -z,
away from the user, and positive turns to the right.
"""

from __future__ import annotations

import math

import numpy as np

from common.mounting import MountingFrame
from common.poses import pose
from common.rotations import rotation_about


def heading(direction: np.ndarray) -> float:
    """Returns the heading [rad] of a direction in the Leap frame, shape (3,); 0 for one that is vertical."""
    return math.atan2(direction[0], -direction[2])


def virtual_leap_pose(mounting: MountingFrame, ws_center: np.ndarray, height: float, psi: float) -> np.ndarray:
    """Returns T_base_virtual, shape (4, 4).

    Args:
        mounting: the operator's directions in the base frame.
        ws_center: centre of the workspace in the base frame, shape (3,) [m].
        height: of that centre above the virtual Leap [m].
        psi: the heading in the Leap frame that shall point forward [rad].
    """
    up, forward = mounting.up, mounting.forward
    straight = np.column_stack([np.cross(forward, up), up, -forward])
    return pose(straight @ rotation_about(1, psi), ws_center - height * up)
