"""How the arm is mounted, and which directions the world's vertical makes of that in the base frame.

The mounting is the attitude of kuka/base_frame against an upright world, as roll, pitch and yaw. The workspace belongs
to the arm and stays in the base frame whatever the mounting; what a person calls up and ahead follows the world:

up: the world's vertical.
ahead: center_line as seen from above. Where center_line rises or falls by more than STEEP_DEG, as it may on a wall,
    the base's z axis as seen from above: away from the wall.
home tool: z down, x along ahead or against it, whichever leaves joint 7 nearer to zero at home.

For an arm on the floor these are the base's z axis, center_line, and against center_line if center_line.x >= 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from common.config import vector
from common.poses import read_only
from common.rotations import rotation_about, rotation_from_zyx, unit

STEEP_DEG = 60.0
EVEN = 1e-9
"""What is nearer to zero than this is rounding."""


def mounting_field() -> Any:
    """Returns the parameter `mounting` for a configuration."""
    return vector(
        3, "deg", low=-180.0, high=180.0, absent=(0.0, 0.0, 0.0), doc="roll, pitch, yaw of the base in an upright world"
    )


def rotation_of_mounting(mounting: ArrayLike) -> np.ndarray:
    """Returns R_world_base, shape (3, 3), of roll, pitch and yaw [deg]."""
    roll, pitch, yaw = np.radians(mounting)
    return rotation_from_zyx(yaw, pitch, roll)


@dataclass(frozen=True, eq=False)
class Directions:
    """The operator's directions, written in the base frame.

    Attributes:
        up: unit vector, shape (3,).
        ahead: unit vector across `up`, shape (3,): where a hand points that points away from its person.
        turned: whether the tool's x axis points back, against `ahead`, when the hand points ahead.
    """

    up: np.ndarray
    ahead: np.ndarray
    turned: bool

    @property
    def R_base_hand(self) -> np.ndarray:
        """Attitude of a level hand that points ahead, shape (3, 3): x ahead, z down."""
        return np.column_stack([self.ahead, np.cross(self.ahead, self.up), -self.up])

    @property
    def R_base_tool(self) -> np.ndarray:
        """Attitude of the tool for that hand, shape (3, 3); the calculated home position has it."""
        return self.turned_hand(self.R_base_hand)

    def turned_hand(self, R_a_hand: np.ndarray) -> np.ndarray:
        """Returns R_a_tool, shape (3, 3), for a hand's attitude in any frame a: turned by 180 deg about z, or not."""
        return R_a_hand @ rotation_about(2, math.pi) if self.turned else R_a_hand


def directions(center_line: ArrayLike, mounting: ArrayLike = (0.0, 0.0, 0.0)) -> Directions:
    """Returns the directions that `mounting` gives.

    Args:
        center_line: horizontal in the base frame, shape (3,), any length.
        mounting: roll, pitch, yaw [deg].

    Raises:
        ValueError: center_line is zero.
    """
    line = unit(center_line)
    up = rotation_of_mounting(mounting)[2]
    level = line - (line @ up) * up
    if np.linalg.norm(level) < math.cos(math.radians(STEEP_DEG)):
        level = np.array([0.0, 0.0, 1.0]) - up[2] * up
    ahead = unit(level)
    # The tool's y axis at home is that of the arm's plane, which joint 1 turns by no more than a quarter.
    sign = 1.0 if line[0] >= 0.0 else -1.0
    plane_y = sign * np.array([-line[1], line[0], 0.0])
    turned = bool(np.cross(up, ahead) @ plane_y >= -EVEN)
    return Directions(read_only(up), read_only(ahead), turned)
