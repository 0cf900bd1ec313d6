"""The law of the robot's servo loop, and the goal that makes the arm go to the wanted joints.

Every millisecond the loop gives the drives a destination: measured joint + f(goal - measured joint). The published
server has f(e) = sign(e) a (1 - exp(-(e/b)^2)), here called LTS; one build of it has f(e) = e. Under the LTS law small
distances vanish ever more slowly. A goal of measured joint + f^-1(wanted step) makes the destination the wanted one.
(Source: docs/handbook/wire-protocols.md, "Servo mode".)

The measured joints here are some milliseconds old, while the loop uses the present ones. They are extrapolated at the
speed that the goal had a moment ago. The remaining error is of second order: near the goal f is flat, which attenuates
it.
"""

from __future__ import annotations

import numpy as np

from common.poses import read_only

REACH_RAD = 0.07
"""a: the greatest step of the loop in one cycle [rad]."""

WIDTH_RAD = 0.0525
"""b: a distance of this size gives a step of 63 % of the reach [rad]."""

STEP_RAD = 0.9 * REACH_RAD
"""The greatest step that is requested, so that a goal is never more than 1.5 b away from the arm [rad]."""

NOISE_RAD = 2e-5
"""Below this step the inverse is linear: its slope at zero is infinite, and noise would make it oscillate [rad]."""

EXTRAPOLATED_S = 0.02
"""Joints are extrapolated by at most this [s]."""

ARM_S = 0.03
"""Mean delay between the speed of the goal and that of the arm [s]; for drives with a time constant of 40 ms."""


def lts(error: np.ndarray) -> np.ndarray:
    """Returns the step f(e) [rad] that the LTS law makes of a distance e to the goal [rad]."""
    return np.copysign(-REACH_RAD * np.expm1(-((error / WIDTH_RAD) ** 2)), error)


def lts_inverse(step: np.ndarray) -> np.ndarray:
    """Returns the distance e [rad] for which the LTS law makes a step [rad].

    Steps beyond STEP_RAD count as STEP_RAD, those below NOISE_RAD give a proportional distance.
    """
    size = np.minimum(np.abs(step), STEP_RAD)
    distance = WIDTH_RAD * np.sqrt(-np.log1p(-np.maximum(size, NOISE_RAD) / REACH_RAD))
    return np.copysign(distance * np.minimum(size / NOISE_RAD, 1.0), step)


class LtsGoals:
    """Goals with which a server of the LTS law reaches the wanted joints, from the start of servo mode on.

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
        self._age = min(self._age + max(dt, 0.0), EXTRAPOLATED_S)
        self._speed = self._speed + (speed - self._speed) * min(max(dt, 0.0) / ARM_S, 1.0)
        present = measured + np.clip(self._age * self._speed, -STEP_RAD, STEP_RAD)
        return read_only(np.clip(present + lts_inverse(wanted - present), self._lower, self._upper))
