"""From one speed of the joints to another within limits of acceleration and jerk, all joints together, by Ruckig."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from common.poses import read_only

EVEN_S = 0.012
"""A change of speed is spread over this time, if the limits do not ask for more [s]."""

STOPPING = (0.25, 0.5, 0.75, 1.0)
"""Shares of the time to a stop at which the way there is looked at."""


@dataclass(frozen=True)
class ShapeLimits:
    """How quickly each joint may change its speed, shape (7,): acceleration [rad/s^2] and jerk [rad/s^3]."""

    acceleration: np.ndarray
    jerk: np.ndarray


@dataclass(frozen=True)
class JointState:
    """Joints on their way.

    Attributes:
        q, v, a: angles [rad], speeds [rad/s], accelerations [rad/s^2], shape (7,) each.
        duration: how long the change of speed takes that they are in [s].
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    duration: float = 0.0


class SpeedChange:
    """Changes the speed of the joints.

    Args:
        shape: limits of acceleration and jerk.
        lower, upper: joint ranges, shape (7,) [rad], that no joint leaves.
    """

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

    def step(self, now: JointState, wish: np.ndarray, dt: float) -> JointState:
        """Returns the joints dt [s] later, on their way to the speeds `wish`, shape (7,) [rad/s]."""
        self._plan(now, wish)
        q, v, a = self._trajectory.at_time(dt)
        within = read_only(np.clip(q, self._lower, self._upper))
        free = within == q
        return JointState(within, np.where(free, v, 0.0), np.where(free, a, 0.0), self._trajectory.duration)

    def stopping(self, now: JointState) -> Iterable[np.ndarray]:
        """Yields joints, shape (7,) [rad], on the way to a stop as soon as possible, the last at rest."""
        self._plan(now, np.zeros(7))
        for share in STOPPING:
            yield np.clip(self._trajectory.at_time(share * self._trajectory.duration)[0], self._lower, self._upper)

    def _plan(self, now: JointState, wish: np.ndarray) -> None:
        state = self._input
        state.current_position, state.current_velocity = now.q.tolist(), now.v.tolist()
        state.current_acceleration, state.target_velocity = now.a.tolist(), wish.tolist()
        result = self._ruckig.calculate(state, self._trajectory)
        if result not in (Result.Working, Result.Finished):
            raise ArithmeticError(f"no motion from speed {now.v} and acceleration {now.a} to speed {wish}: {result}")
