"""Motions along a path in joint space, planned in advance: smooth in speed, all joints synchronised.

A motion is a function of its own time, which the arm may slow down, stop and resume.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from common.poses import read_only


class PlannedMotion(Protocol):
    """A planned motion: `duration` [s], and `at(t)` = joint angles, shape (7,) [rad], at its own time t."""

    duration: float

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]; beyond the duration those of the end."""


class SmoothStep:
    """The path parameter s from 0 to 1: its speed rises as sin^2 over a ramp, stays, and falls likewise.

    Args:
        speed: highest speed [1/s].
        acceleration: highest acceleration [1/s^2].
    """

    def __init__(self, speed: float, acceleration: float) -> None:
        self._speed = min(speed, (2.0 * acceleration / np.pi) ** 0.5)
        self._ramp = np.pi * self._speed / (2.0 * acceleration)
        self.duration = 1.0 / self._speed + self._ramp

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
    """A line in joint space.

    Args:
        start, end: joint angles, shape (7,) [rad]; they must differ.
        speed: highest speed of each joint, shape (7,) [rad/s].
        acceleration: highest acceleration of each joint, shape (7,) [rad/s^2].
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self._start, self._end = read_only(start), read_only(end)
        self._shift = self._end - self._start
        distance = np.abs(self._shift)
        moved = distance > 0.0
        self._step = SmoothStep(
            float(np.min(speed[moved] / distance[moved])), float(np.min(acceleration[moved] / distance[moved]))
        )
        self.duration = self._step.duration

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]."""
        return self._end if t >= self.duration else self._start + self._step.at(t) * self._shift


class PathMove:
    """A path through joint angles at equal steps of s, slowed down until every joint keeps its limits.

    Args:
        nodes: joint angles, shape (n, 7) [rad], n >= 2.
        step: desired course of s from 0 to 1.
        speed, acceleration: limits of each joint, shape (7,) [rad/s], [rad/s^2].
    """

    SAMPLES = 500

    def __init__(self, nodes: np.ndarray, step: SmoothStep, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self._nodes = read_only(nodes)
        self._slopes = read_only(np.gradient(self._nodes, axis=0))
        self._step = step
        dt = step.duration / self.SAMPLES
        q = np.array([self._at_parameter(step.at(k * dt)) for k in range(self.SAMPLES + 1)])
        v = np.diff(q, axis=0) / dt
        a = np.diff(v, axis=0) / dt
        self._slower = max(1.0, np.max(np.abs(v) / speed), np.max(np.abs(a) / acceleration) ** 0.5)
        self.duration = step.duration * self._slower

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]."""
        return self._at_parameter(self._step.at(t / self._slower))

    def _at_parameter(self, s: float) -> np.ndarray:
        last = len(self._nodes) - 1
        k = min(int(s * last), last - 1)
        u = s * last - k
        w = u * u * (3.0 - 2.0 * u)
        left, right = self._nodes[k], self._nodes[k + 1]
        bend = u * (1.0 - u) * ((1.0 - u) * self._slopes[k] - u * self._slopes[k + 1])
        return left + w * (right - left) + bend
