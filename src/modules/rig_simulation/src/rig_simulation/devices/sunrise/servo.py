"""The servo modes' path from a goal to a speed: the server's law, and the drives of the simulated arm.

The server's loop gives DirectServo a destination every cycle: measured joint + f(goal - measured joint). The model of
DirectServo: each joint moves towards its destination with the mid-point speed of a smooth move of the minimum
trajectory time (distance / (2/3 T)), never faster than it can brake before the destination, and within its speed and
acceleration limits. So it approaches a step in the goal from one side, without overshoot.
"""

from __future__ import annotations

from typing import Callable

import numpy as np

LTS_REACH_RAD = 0.07
LTS_WIDTH_RAD = 0.0525
MIN_TRAJECTORY_TIME_S = 0.04
CYCLE_S = 1e-3
BRAKING_FRACTION = 0.8
"""Braking uses this fraction of the acceleration limit; the server's law needs the rest."""

Law = Callable[[np.ndarray], np.ndarray]


def lts_law(error: np.ndarray) -> np.ndarray:
    """Returns f(e) = sign(e) a (1 - exp(-(e/b)^2)) [rad], the law of the published server (builds 1.5 to LTS).

    Args:
        error: goal - measured, shape (n,) [rad].
    """
    scaled = error / LTS_WIDTH_RAD
    return np.copysign(LTS_REACH_RAD * -np.expm1(-scaled * scaled), error)


def plain_law(error: np.ndarray) -> np.ndarray:
    """Returns f(e) = e, the law of the 1.7 build for the pneumatic flange."""
    return error


LAWS = {"lts": lts_law, "none": plain_law}


class Drives:
    """Computes the speed of the joints after one step.

    Args:
        speed, acceleration: limits of each joint, shape (7,) [rad/s], [rad/s^2].
        trajectory_time: DirectServo's minimum trajectory time [s].
    """

    def __init__(self, speed: np.ndarray, acceleration: np.ndarray, trajectory_time: float) -> None:
        self._speed = speed
        self._acceleration = acceleration
        self._lag = 2.0 / 3.0 * trajectory_time
        self._braking = BRAKING_FRACTION * acceleration
        self._linear_range = self._braking * self._lag**2

    def towards(self, distance: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Returns the speed, shape (7,) [rad/s], after a step of dt [s] towards a destination.

        Args:
            distance: destination - measured, shape (7,) [rad].
            v: present speed, shape (7,) [rad/s].
            dt: length of the step [s].
        """
        path = np.abs(distance)
        far = np.maximum(path, self._linear_range)
        wanted = np.minimum(path / self._lag, np.sqrt(2.0 * self._braking * (far - 0.5 * self._linear_range)))
        wanted = np.copysign(np.minimum(wanted, self._speed), distance)
        change = self._acceleration * dt
        return v + np.minimum(np.maximum(wanted - v, -change), change)

    def brake(self, v: np.ndarray, dt: float) -> np.ndarray:
        """Returns the speed, shape (7,) [rad/s], after a step of dt [s] of braking."""
        change = self._acceleration * dt
        return v - np.minimum(np.maximum(v, -change), change)
