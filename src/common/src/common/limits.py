"""What keeps an arm from its desired tool frame, or its goals from their desired velocity: the names in
kuka/status.limited_by."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum


class Limit(str, Enum):
    """A limit; it compares equal to its text in a message."""

    # Bounds of the workspace to which the desired position was constrained, in the order of their application.
    OPENING_ANGLE = "opening angle"
    Z_LOWER = "lower z limit"
    Z_UPPER = "upper z limit"
    INNER_SPHERE = "inner sphere"
    OUTER_SPHERE = "outer sphere"
    REACH = "reach"  # the orientation yields
    # Of the motion of the goals.
    WORKSPACE = "workspace"  # the tool slides along a bound
    JOINT_RANGE = "joint limit"
    JOINT_SPEED = "joint speed"
    ARM_SPEED = "arm speed"
    FRAME_RATE = "frame rate"
    ACCELERATION = "joint acceleration"
    LAG = "lag of the arm"
    COLLISION_GUARD = "collision guard"
    LATE_GOAL = "gap between goals"

    def __str__(self) -> str:
        return self.value

    @property
    def edge(self) -> bool:
        """Whether the arm is at the edge of the positions where it may be."""
        return self in (*BOUNDS, Limit.WORKSPACE, Limit.JOINT_RANGE)

    @property
    def speed(self) -> bool:
        """Whether the hand is faster than the arm may be."""
        return self in (Limit.JOINT_SPEED, Limit.ARM_SPEED)


BOUNDS = (Limit.OPENING_ANGLE, Limit.Z_LOWER, Limit.Z_UPPER, Limit.INNER_SPHERE, Limit.OUTER_SPHERE)


def known_limits(names: Iterable[str]) -> tuple[Limit, ...]:
    """Returns the limits of a message; one that a newer version of kuka_control has added is left out."""
    known = {limit.value for limit in Limit}
    return tuple(Limit(name) for name in names if name in known)
