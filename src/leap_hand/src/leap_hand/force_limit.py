"""Stops a finger of the robot hand from closing further when it presses: once a taxel or its motor's load exceeds the
limit, until all have fallen below a fraction of it. Without a state of the robot hand all fingers are limited. Angles
of commands [rad], 0 = open; the spread is not limited."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from leap_hand.config import FINGERS, HandConfig

FEELING = FINGERS[:3]  # fingers with taxels, in the order of the commands and of the hand's state


@dataclass(frozen=True)
class FingerFeedback:
    """What the robot hand measures at index, middle and thumb."""

    angles: tuple[float, ...]  # of the fingers [rad]
    pressures: tuple[tuple[float, ...], ...]  # nine taxels each [counts]
    loads: tuple[float, ...]  # of their motors, closing positive [0.1 % of the largest torque]


@dataclass(frozen=True)
class LimitedCommand:
    """A command within the force limit."""

    command: np.ndarray  # angles of index, middle, thumb, spread, shape (4,) [rad]
    limited: dict[str, str]  # reason by name of the finger
    silence: str  # why all fingers are limited, or empty


class ForceLimit:
    """The limit with its state; `trips` counts how often a finger was stopped."""

    def __init__(self, config: HandConfig) -> None:
        self._config = config
        self._received: float | None = None
        self._reasons: dict[str, str] = {}
        self._largest = [math.inf] * len(FEELING)
        self._sent = [0.0] * len(FEELING)
        self.trips = 0

    def update(self, feedback: FingerFeedback, now: float) -> bool:
        """Updates the limits; returns whether this stops a finger that was free before. Takes the time of the
        feedback's arrival on a monotonic clock [s]. Numbers that are not finite are ignored."""
        if not self._config.force_limit:
            return False
        numbers = [*feedback.angles, *feedback.loads, *(count for taxels in feedback.pressures for count in taxels)]
        if not all(map(math.isfinite, numbers)):
            return False
        self._received = now
        trips = self.trips
        for i, finger in enumerate(FEELING):
            taxels, load = feedback.pressures[i], feedback.loads[i]
            taxel = max(range(len(taxels)), key=taxels.__getitem__)
            fractions = (taxels[taxel] / self._config.force_limit_pressure, load / self._config.force_limit_load)
            if max(fractions) > 1.0:
                if finger not in self._reasons:
                    self.trips += 1
                    self._largest[i] = min(self._sent[i], feedback.angles[i])
                pressed = f"taxel {taxel}: {taxels[taxel]:.0f} counts"
                self._reasons[finger] = pressed if fractions[0] > 1.0 else f"load {load:.0f}"
            elif max(fractions) < self._config.force_limit_release and finger in self._reasons:
                del self._reasons[finger]
                self._largest[i] = math.inf
        return self.trips > trips

    def clip(self, command: Sequence[float], now: float) -> LimitedCommand:
        """Returns the part of a command that is allowed: angles of index, middle, thumb, spread, shape (4,) [rad]."""
        allowed = np.array(command, dtype=float)
        if not self._config.force_limit:
            return LimitedCommand(read_only(allowed), {}, "")
        silence = self._silence(now)
        for i, finger in enumerate(FEELING):
            if silence:
                allowed[i] = min(allowed[i], self._sent[i])
            allowed[i] = min(allowed[i], self._largest[i])
            if finger in self._reasons:
                self._largest[i] = allowed[i]
            self._sent[i] = float(allowed[i])
        return LimitedCommand(read_only(allowed), dict(self._reasons), silence)

    def _silence(self, now: float) -> str:
        if self._received is None:
            return "no state of the robot hand came yet: no finger closes"
        if now - self._received <= self._config.force_limit_silence:
            return ""
        return "the state of the robot hand is unknown: no finger closes further"
