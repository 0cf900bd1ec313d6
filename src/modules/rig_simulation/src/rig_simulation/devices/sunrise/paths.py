"""Joint motions planned in advance. A motion is smooth in speed and synchronises all joints; it is a function of its
own time, which the arm may slow down, stop and resume."""

from __future__ import annotations

import numpy as np

from common.poses import read_only


class SmoothStep:
    """The path parameter s from 0 to 1: its speed rises as sin^2 over a ramp, stays, and falls likewise; `speed` [1/s]
    and `acceleration` [1/s^2] are the highest ones."""

    def __init__(self, speed: float, acceleration: float) -> None:
        self._speed = min(speed, (2.0 * acceleration / np.pi) ** 0.5)
        self._ramp = np.pi * self._speed / (2.0 * acceleration)
        self.duration = 1.0 / self._speed + self._ramp
        self.braking_time = self._speed / acceleration

    def at(self, t: float) -> float:
        """Returns s at time t [s]."""
        if t <= 0.0:
            return 0.0
        if t >= self.duration:
            return 1.0
        if t > 0.5 * self.duration:
            return 1.0 - self.at(self.duration - t)
        if t >= self._ramp:
            return self._speed * (t - 0.5 * self._ramp)
        return self._speed * (0.5 * t - self._ramp / (2.0 * np.pi) * np.sin(np.pi * t / self._ramp))


class JointMove:
    """A line in joint space between two different sets of joint angles, shape (7,) [rad], within the limits `speed` and
    `acceleration` of each joint, shape (7,) [rad/s], [rad/s^2]. `braking_time`: from its greatest speed to rest, at its
    greatest acceleration [s]."""

    def __init__(self, start: np.ndarray, end: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self._start, self._end = read_only(start), read_only(end)
        self._shift = self._end - self._start
        distance = np.abs(self._shift)
        moved = distance > 0.0
        self._step = SmoothStep(
            float(np.min(speed[moved] / distance[moved])), float(np.min(acceleration[moved] / distance[moved]))
        )
        self.duration, self.braking_time = self._step.duration, self._step.braking_time

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]."""
        return self._end if t >= self.duration else self._start + self._step.at(t) * self._shift


class Unreachable(ValueError):
    """An impossible motion: no speed, or a goal out of range."""
