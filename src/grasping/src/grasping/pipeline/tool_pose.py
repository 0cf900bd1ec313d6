"""From a grasp to the pose of the arm's tool that takes it.

Frame of a grasp: origin on the surface between the fingers, x through both fingers, z along the approach. A gripper
does not care which of its fingers is on which side, so a grasp allows two orientations half a turn apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from common.config import choice, number, vector
from common.poses import pose, translation
from common.rotations import rotation_about, rotation_angle, unit

VERTICAL, ALONG_GRASP = "vertical", "grasp"
UP = (0.0, 0.0, 1.0)
STEEP = math.cos(math.radians(80.0))
"""Fingers whose line rises more steeply than this have no heading."""


@dataclass(frozen=True)
class ToolPoseConfig:
    """The schema of tool_pose.yaml."""

    grip_in_tool: np.ndarray = vector(3, "m", low=-0.5, high=0.5, doc="where the grasp's origin is in the tool's frame")
    closing_angle: float = number(
        "deg", low=-180.0, high=180.0, doc="from the tool's x axis, about its z axis, to the line the fingers close on"
    )
    approach: str = choice(VERTICAL, ALONG_GRASP, doc="vertical: the tool points down; grasp: along the grasp's z axis")
    clearance: float = number("m", low=0.0, high=0.5, doc="how far the tool stops before the grasp")
    max_opening: float = number("m", above=0.0, high=0.5, doc="widest thing that the open hand takes")
    preferred_opening: np.ndarray = vector(
        2, "m", low=0.0, high=0.5, absent=(0.0, 0.5), doc="least and largest opening that the hand holds best"
    )
    outside_quality: float = number(
        above=0.0,
        high=1.0,
        absent=1.0,
        doc="fraction of the quality above peaks/threshold that is left for other openings; 1 = no preference",
    )
    outside_ramp: float = number(
        "m", above=0.0, high=0.1, absent=0.01, doc="change of the opening over which the fraction falls to that"
    )

    def faults(self) -> list[str]:
        """Names what no single field can check."""
        low, high = self.preferred_opening
        if low < high:
            return []
        return [f"preferred_opening is [{low:g}, {high:g}], but the least must be below the largest."]


def tool_pose(T_base_grasp: np.ndarray, settings: ToolPoseConfig, near: np.ndarray, up: ArrayLike = UP) -> np.ndarray:
    """Returns the pose of the tool that takes the grasp, T_base_tool, shape (4, 4) [m].

    Args:
        T_base_grasp: shape (4, 4) [m].
        near: an orientation R_base_tool, shape (3, 3); of the two possible ones the nearer is taken.
        up: the vertical in the base frame, shape (3,).

    Raises:
        ValueError: the approach is vertical, and so is the line through the fingers.
    """
    z = -unit(up) if settings.approach == VERTICAL else T_base_grasp[:3, 2]
    fingers = T_base_grasp[:3, 0]
    across = fingers - (fingers @ z) * z
    if np.linalg.norm(across) < STEEP:
        raise ValueError(f"the line through the fingers, {fingers.tolist()}, lies along the approach")
    x = unit(across)
    R = np.column_stack([x, np.cross(z, x), z]) @ rotation_about(2, -math.radians(settings.closing_angle))
    R = min((R, R @ rotation_about(2, math.pi)), key=lambda R_base_tool: rotation_angle(near.T @ R_base_tool))
    return pose(R, T_base_grasp[:3, 3] - R @ settings.grip_in_tool)


def above(T_base_tool: np.ndarray, clearance: float) -> np.ndarray:
    """Returns the tool's pose so far before it, against its z axis: above it where it points down [m]."""
    return T_base_tool @ translation(0.0, 0.0, -clearance)
