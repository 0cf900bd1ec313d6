"""How far a grasp is from the wanted one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.poses import inverse
from common.rotations import rotation_about, rotation_angle

NEAR_M = 0.020
NEAR_RAD = np.radians(15.0)


class Miss(NamedTuple):
    """A grasp against the wanted one."""

    position: float  # distance [m]
    rotation: float  # angle between the orientations, half a turn about the approach being none [rad]

    @property
    def is_near(self) -> bool:
        """Whether both are within 20 mm and 15 degrees."""
        return self.position < NEAR_M and self.rotation < NEAR_RAD


def miss(T_wanted: np.ndarray, T_found: np.ndarray) -> Miss:
    """Returns how far a grasp, shape (4, 4) [m], is from the wanted one."""
    T = inverse(T_wanted) @ T_found
    R = T[:3, :3]
    rotation = min(rotation_angle(R), rotation_angle(R @ rotation_about(2, np.pi)))
    return Miss(float(np.linalg.norm(T[:3, 3])), float(rotation))
