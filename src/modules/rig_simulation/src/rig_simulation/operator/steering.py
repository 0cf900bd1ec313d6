"""A hand of the operator that steers a tool: it moves by what the tool lacks to its target.

All that is known of the controller is that the tool follows the hand. Positions in metres, times in seconds, in a frame
whose z axis points up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig_simulation.operator.motion import MIN_JERK_PEAK

UP = np.array([0.0, 0.0, 1.0])
GRIP_OFFSET = (-0.0152, 0.0, 0.0)
"""From the tool point to the middle between fingers and thumb, in the flange's axes [m]: the hand's x axis is reversed
there, and its knuckles are at x = 60.4 mm and x = -30 mm."""

FARTHEST_M = 0.5
"""Largest displacement of the palm from its entry, along each axis [m]."""


@dataclass(frozen=True)
class Habits:
    """How a hand moves."""

    speed: float = 0.1  # highest speed of the palm [m/s]
    turn_speed: float = 0.5  # highest angular speed of the hand about the vertical [rad/s]
    at_rest: float = 0.005  # speed below which the tool counts as at rest [m/s]
    closing: float = 2.5  # time for the fingers [s]
    opening: float = 1.5  # time for the fingers [s]
    patience: float = 30.0  # longest time for one step [s]


@dataclass(frozen=True)
class Move:
    """Target of the hand: right, up and back from its entry [m], yaw to the right [rad], curl 0 to 1, time [s]."""

    palm: np.ndarray
    yaw: float
    curl: float
    seconds: float

    @property
    def fields(self) -> dict[str, float]:
        right, up, back = self.palm.tolist()
        return {"right": right, "up": up, "back": back, "yaw": self.yaw, "curl": self.curl, "seconds": self.seconds}


class SteeringHand:
    """The hand. `forward`: direction in which it points when it comes in, shape (3,), z = 0."""

    def __init__(self, habits: Habits, forward: np.ndarray) -> None:
        forward = np.asarray(forward, dtype=float) / np.linalg.norm(forward)
        self._habits = habits
        self._R_leap_base = np.array([np.cross(forward, UP), UP, -forward])
        self.palm, self.yaw, self.curl = np.zeros(3), 0.0, 0.0
        self._busy_until = 0.0
        self._before: tuple[float, np.ndarray] | None = None
        self._at_rest = False

    def enter(self) -> None:
        """The hand has come in anew, with its fingers as they were."""
        self.palm, self.yaw = np.zeros(3), 0.0

    def see(self, grip: np.ndarray, now: float) -> None:
        """Takes where the tool's gripping point is, shape (3,) [m]."""
        before, self._before = self._before, (now, grip)
        self._at_rest = (
            before is not None
            and now > before[0]
            and float(np.linalg.norm(grip - before[1])) / (now - before[0]) < self._habits.at_rest
        )

    def ready(self, now: float) -> bool:
        """Returns whether the last move is over and the tool at rest."""
        return now >= self._busy_until and self._at_rest

    def wait(self, seconds: float, now: float) -> None:
        """Lets the hand rest for a time [s]."""
        self._busy_until = now + seconds

    def shift(self, by: np.ndarray, now: float, turn: float = 0.0) -> Move:
        """Returns the move that shifts the tool, shape (3,) [m], and turns it anticlockwise from above [rad]."""
        shortest_move_s = 0.4
        settle_s = 0.3
        self.palm = np.clip(self.palm + self._R_leap_base @ by, -FARTHEST_M, FARTHEST_M)
        self.yaw -= turn
        fastest = max(float(np.linalg.norm(by) / self._habits.speed), abs(turn) / self._habits.turn_speed)
        seconds = max(shortest_move_s, MIN_JERK_PEAK * fastest)
        self._busy_until = now + seconds + settle_s
        return Move(self.palm, self.yaw, self.curl, seconds)

    def close(self, now: float) -> Move:
        return self._bend(1.0, self._habits.closing, now)

    def open(self, now: float) -> Move:
        return self._bend(0.0, self._habits.opening, now)

    def _bend(self, curl: float, seconds: float, now: float) -> Move:
        """Returns the move of the fingers; the robot's fingers, which are slower, get `seconds` in all."""
        finger_fraction = 0.6  # the operator's fingers move for this fraction of the robot fingers' time
        self.curl = curl
        self._busy_until = now + seconds
        return Move(self.palm, self.yaw, curl, finger_fraction * seconds)
