"""How the arm is mounted, the operator's directions that follow from it in the base frame, and the tool on its flange.

The parameter `mounting` is the orientation of kuka/base_frame in an upright world, as roll, pitch and yaw. The
workspace belongs to the arm and stays in the base frame; what the operator calls up and forward follows the world:

up: the world's vertical.
forward: center_line as seen from above. Where center_line rises or falls by more than STEEP_DEG, as it may on a wall,
    the base's z axis as seen from above: away from the wall.
home tool: z down, x along forward or against it, whichever leaves joint 7 nearer to zero at home.

For an arm on the floor these are the base's z axis, center_line, and against center_line if center_line.x >= 0."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from common.config import flag, number, vector
from common.poses import check_pose, read_only, translation
from common.rotations import rotation_about, rotation_from_zyx, unit

STEEP_DEG = 60.0
MAX_TOOL_M = 1.0  # a tool point farther from the flange is probably given in millimetres
EVEN = 1e-9  # a smaller value is a rounding error


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
class MountingFrame:
    """The operator's directions in the base frame."""

    up: np.ndarray  # unit vector, shape (3,)
    forward: np.ndarray  # unit vector across `up`, shape (3,): of a hand that points away from the operator
    tool_reversed: bool  # whether the tool's x axis points against `forward` when the hand points forward

    @property
    def R_base_hand(self) -> np.ndarray:
        """Orientation of a level hand that points forward, shape (3, 3): x forward, z down."""
        return np.column_stack([self.forward, np.cross(self.forward, self.up), -self.up])

    @property
    def R_base_tool(self) -> np.ndarray:
        """Orientation of the tool for that hand, shape (3, 3), which the calculated home position has."""
        return self.tool_from_hand(self.R_base_hand)

    def tool_from_hand(self, R_a_hand: np.ndarray) -> np.ndarray:
        """Returns R_a_tool, shape (3, 3), for a hand's orientation in any frame a."""
        return R_a_hand @ rotation_about(2, math.pi) if self.tool_reversed else R_a_hand


def mounting_frame(center_line: ArrayLike, mounting: ArrayLike = (0.0, 0.0, 0.0)) -> MountingFrame:
    """Returns the operator's directions. `center_line` is horizontal in the base frame, shape (3,), of any length,
    `mounting` is roll, pitch, yaw [deg]. Raises ValueError if center_line is zero."""
    line = unit(center_line)
    up = rotation_of_mounting(mounting)[2]
    level = line - (line @ up) * up
    if np.linalg.norm(level) < math.cos(math.radians(STEEP_DEG)):
        level = np.array([0.0, 0.0, 1.0]) - up[2] * up
    forward = unit(level)
    # The tool's y axis at home is that of the arm's plane, which joint 1 turns by at most a quarter turn.
    sign = 1.0 if line[0] >= 0.0 else -1.0
    plane_y = sign * np.array([-line[1], line[0], 0.0])
    tool_reversed = bool(np.cross(up, forward) @ plane_y >= -EVEN)
    return MountingFrame(read_only(up), read_only(forward), tool_reversed)


@dataclass(frozen=True)
class ToolConfig:
    """The tool: a length along the flange's z axis for most; a whole pose for a rotated or offset one."""

    tool_length: float = number("m", low=0.0, high=MAX_TOOL_M, doc="from flange to tool point, along its z axis")
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
