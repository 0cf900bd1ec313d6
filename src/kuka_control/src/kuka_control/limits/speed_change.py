"""Changes of the joint velocities within limits of acceleration and jerk, all joints in step, by Ruckig."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from common.poses import read_only

EVEN_S = 0.012
"""Least duration of a velocity change [s]."""

STOPPING = (0.25, 0.5, 0.75, 1.0)
"""Fractions of the braking time at which the path to the stop is checked."""


@dataclass(frozen=True)
class ShapeLimits:
    """How quickly each joint may change its speed, shape (7,): acceleration [rad/s^2] and jerk [rad/s^3]."""

    acceleration: np.ndarray
    jerk: np.ndarray


@dataclass(frozen=True)
class JointState:
    """Joint angles [rad], velocities [rad/s] and accelerations [rad/s^2], shape (7,) each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    duration: float = 0.0
    """Of the whole velocity change [s]."""


class SpeedChange:
    """Changes the joint velocities; no joint leaves its range `lower` to `upper`, shape (7,) [rad]."""

    def __init__(self, shape: ShapeLimits, lower: np.ndarray, upper: np.ndarray) -> None:
        self._lower = lower
        self._upper = upper
        self._ruckig = Ruckig(7)
        self._trajectory = Trajectory(7)
        self._input = InputParameter(7)
        self._input.control_interface = ControlInterface.Velocity
        self._input.max_acceleration = shape.acceleration.tolist()
        self._input.max_jerk = shape.jerk.tolist()
        self._input.target_acceleration = [0.0] * 7
        self._input.minimum_duration = EVEN_S

    def step(self, now: JointState, desired: np.ndarray, dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the velocities `desired`, shape (7,) [rad/s]."""
        self._plan(now, desired)
        q, v, a = self._trajectory.at_time(dt)
        within = read_only(np.clip(q, self._lower, self._upper))
        free = within == q
        return JointState(within, np.where(free, v, 0.0), np.where(free, a, 0.0), self._trajectory.duration)

    def stopping(self, now: JointState) -> Iterable[np.ndarray]:
        """Yields joints, shape (7,) [rad], on the path to the earliest stop; the last are at rest."""
        self._plan(now, np.zeros(7))
        for fraction in STOPPING:
            yield np.clip(self._trajectory.at_time(fraction * self._trajectory.duration)[0], self._lower, self._upper)

    def _plan(self, now: JointState, desired: np.ndarray) -> None:
        state = self._input
        state.current_position, state.current_velocity = now.q.tolist(), now.v.tolist()
        state.current_acceleration, state.target_velocity = now.a.tolist(), desired.tolist()
        result = self._ruckig.calculate(state, self._trajectory)
        if result not in (Result.Working, Result.Finished):
            raise ArithmeticError(f"no motion from velocity {now.v} and acceleration {now.a} to {desired}: {result}")
