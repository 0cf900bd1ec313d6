"""The moving arm as its limits see it: joint states, and the points whose speed counts: elbow, wrist and flange, the
tool point, the finger tips, and what is mounted or held at the flange. They stand for the whole arm: of a rigid body
the farthest point is the fastest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from common.errors import RigError
from iiwa_kinematics import Ball, Kinematics

STOPPING = (0.0, 0.1, 0.3, 0.6, 1.0)
"""Fractions of the stopping time at which the position of the tool and the distances of the bodies are checked."""


class GuardError(RigError):
    """The collision guard cannot say what the arm may do; the arm has to stop."""


@dataclass(frozen=True)
class ShapeLimits:
    """How quickly each joint may change its speed, shape (7,): acceleration [rad/s^2] and jerk [rad/s^3]."""

    acceleration: np.ndarray
    jerk: np.ndarray


@dataclass(frozen=True)
class JointState:
    """Joint angles [rad], velocities [rad/s] and accelerations [rad/s^2], 7 each."""

    q: list[float]
    v: list[float]
    a: list[float]
    duration: float = 0.0  # of the whole velocity change [s]

    @classmethod
    def rest(cls, q: list[float]) -> JointState:
        return cls(q, [0.0] * 7, [0.0] * 7)


class MovingPoints:
    """The points of an arm with its tool; those that the flange carries are in balls."""

    def __init__(self, kinematics: Kinematics, carried: Iterable[Ball] = ()) -> None:
        self._kinematics = kinematics
        self._q: Sequence[float] | None = None  # the joints last asked for, and the answer
        self._point: tuple[Sequence[float], Sequence[float]] = (), ()
        self.carry(carried)

    def carry(self, balls: Iterable[Ball]) -> None:
        """Takes over what the flange carries from now on, besides the tool point."""
        tool = self._kinematics.T_flange_tool[:3, 3].tolist()
        self._balls = [(*tool, 0.0), *balls]
        self._around = max(math.dist(centre, tool) + radius for *centre, radius in [(0.0,) * 4, *self._balls])
        self._q = None

    def speed(self, q: Sequence[float], v: Sequence[float]) -> float:
        """Returns the speed of the fastest point [m/s] at joints q, 7 [rad], for joint speeds v, 7 [rad/s]."""
        return self._kinematics.fastest_point(self._balls, q, v)

    def tool_point(self, q: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
        """Returns the tool point, x, y, z [m], and how far no point is beyond from each of the 7 joint axes [m]. At
        the joints q, 7 [rad]; of the same list they are calculated once."""
        if q is not self._q:
            self._q, self._point = q, self._kinematics.tool_point(q, self._around)
        return self._point


def approach_speed(distance: float, deceleration: float, gain: float) -> float:
    """Returns the greatest speed at a distance from a bound, so that the deceleration ends there. The last part is
    exponential, with `gain` [1/s], so that the deceleration does not end at once. Any unit of length."""
    linear = deceleration / gain**2
    if distance <= linear:
        return gain * max(distance, 0.0)
    return math.sqrt(2.0 * deceleration * (distance - 0.5 * linear))
