"""How near predictions come to an operator's grasps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.poses import inverse
from common.rotations import rotation_about, rotation_angle

NEAR_M, NEAR_RAD = 0.020, np.radians(15.0)
HALF_TURN = rotation_about(2, np.pi)


class Miss(NamedTuple):
    """A predicted grasp against the operator's."""

    position: float  # distance [m]
    rotation: float  # angle between the orientations, half a turn about the approach being none [rad]

    @property
    def is_near(self) -> bool:
        """Whether both are within 20 mm and 15 degrees."""
        return self.position < NEAR_M and self.rotation < NEAR_RAD


def miss(T_wanted: np.ndarray, T_found: np.ndarray) -> Miss:
    """Returns how far a grasp, shape (4, 4) [m], is from the wanted one."""
    T = inverse(T_wanted) @ T_found
    return Miss(float(np.linalg.norm(T[:3, 3])), rotation_miss(T_wanted[:3, :3], T_found[:3, :3]))


def rotation_miss(R_wanted: np.ndarray, R_found: np.ndarray) -> float:
    """Returns the angle between orientations, shape (3, 3), half a turn about the approach being none [rad]."""
    R = R_wanted.T @ R_found
    return float(min(rotation_angle(R), rotation_angle(R @ HALF_TURN)))
