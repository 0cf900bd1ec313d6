"""Where the Leap stands in the robot's world.

The virtual Leap stands upright below the centre of the workspace. It is turned about its vertical axis so that one
horizontal direction of the real Leap frame, the heading, points along the centre line.

A heading is the angle psi [rad] of a horizontal direction (sin psi, 0, -cos psi) in the Leap frame: 0 points along -z,
away from the user, and positive turns to the right.
"""

from __future__ import annotations

import math

import numpy as np

from common.poses import pose
from common.rotations import rotation_about, unit


def heading(direction) -> float:
    """Returns the heading [rad] of a direction in the Leap frame, shape (3,); 0 for one that is vertical."""
    return math.atan2(direction[0], -direction[2])


def virtual_leap_pose(center_line, ws_center, z_lower_limit: float, z_clearance: float, psi: float) -> np.ndarray:
    """Returns T_base_virtual, shape (4, 4).

    Args:
        center_line: horizontal direction in the base frame, shape (3,).
        ws_center: centre of the workspace in the base frame, shape (3,) [m].
        z_lower_limit: lower limit of the workspace [m].
        z_clearance: how far the virtual Leap lies below that limit [m].
        psi: the heading in the Leap frame that shall point along `center_line` [rad].

    Raises:
        ValueError: center_line is zero.
    """
    ahead = unit(center_line)
    up = np.array([0.0, 0.0, 1.0])
    straight = np.column_stack([np.cross(ahead, up), up, -ahead])
    origin = (ws_center[0], ws_center[1], z_lower_limit - z_clearance)
    return pose(straight @ rotation_about(1, psi), origin)
