"""What the robot's servo loop makes of a goal, and the goal that makes it go where it is wanted.

Every millisecond the loop gives the drives a destination: measured joint + f(goal - measured joint). The published
server has f(e) = sign(e) a (1 - exp(-(e/b)^2)), here called LTS; a build of its has f(e) = e. Under the LTS law small
distances are worked off ever more slowly. Whoever sends measured joint + f^-1(wanted step) makes the destination the
wanted one. (Source: docs/handbook/wire-protocols.md, "Servo mode".)

The joints that are known here are some milliseconds old while the loop uses those of the moment. They are carried on at
the speed that the goal had a moment ago. What remains is of second order: near the goal f is flat, so an error in them
is weakened.
"""

from __future__ import annotations

import numpy as np

from common.poses import read_only

REACH_RAD = 0.07
"""a: the loop goes no further than this in one cycle [rad]."""

WIDTH_RAD = 0.0525
"""b: a distance of this size is taken to 63 % of the reach [rad]."""

STEP_RAD = 0.9 * REACH_RAD
"""No further step is asked for, so that a goal is never more than 1.5 b away from the arm [rad]."""

NOISE_RAD = 2e-5
"""Below this distance the inverse is a straight line: its slope at zero is infinite, and noise would make it ring."""

CARRIED_S = 0.02
"""Joints are carried on for no longer than this [s]."""

ARM_S = 0.03
"""The arm is taken to have the speed that its goal had this long ago, on average [s]; for drives of 40 ms."""


def lts(error: np.ndarray) -> np.ndarray:
    """Returns the step f(e) [rad] that the LTS law makes of a distance e to the goal [rad]."""
    return np.copysign(-REACH_RAD * np.expm1(-((error / WIDTH_RAD) ** 2)), error)


def lts_inverse(step: np.ndarray) -> np.ndarray:
    """Returns the distance e [rad] of which the LTS law makes a step [rad].

    Steps beyond STEP_RAD count as STEP_RAD, those below NOISE_RAD give a proportional distance.
    """
    size = np.minimum(np.abs(step), STEP_RAD)
    distance = WIDTH_RAD * np.sqrt(-np.log1p(-np.maximum(size, NOISE_RAD) / REACH_RAD))
    return np.copysign(distance * np.minimum(size / NOISE_RAD, 1.0), step)


class LtsGoals:
    """Goals that a server with the LTS law takes for the wanted ones, from the start of servo mode.

    Args:
        lower, upper: joint ranges, shape (7,) [rad], that no goal leaves.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray) -> None:
        self._lower = lower
        self._upper = upper
        self._measured: np.ndarray | None = None
        self._age = 0.0
        self._speed = np.zeros(7)

    def step(self, wanted: np.ndarray, speed: np.ndarray, measured: np.ndarray, dt: float) -> np.ndarray:
        """Returns the goal to send, shape (7,) [rad].

        Args:
            wanted: destination of the joints, shape (7,) [rad].
            speed: of the wanted joints, shape (7,) [rad/s].
            measured: the newest joints that are known, shape (7,) [rad]; the same object until newer ones come.
            dt: time since the last call [s].
        """
        if measured is not self._measured:
            self._measured, self._age = measured, 0.0
        self._age = min(self._age + max(dt, 0.0), CARRIED_S)
        self._speed = self._speed + (speed - self._speed) * min(max(dt, 0.0) / ARM_S, 1.0)
        carried = measured + np.clip(self._age * self._speed, -STEP_RAD, STEP_RAD)
        return read_only(np.clip(carried + lts_inverse(wanted - carried), self._lower, self._upper))
