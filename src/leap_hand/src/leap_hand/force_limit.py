"""Stops a finger of the robot hand from closing further when it presses: gentle to a cup, firm enough to lift it.

A finger is limited from the moment when one of its tactile cells or its motor's load exceeds the limit, until all of
them have fallen below a share of it. Meanwhile it is not commanded to close further; opening is always allowed. While
the state of the hand is not known, all fingers are held in this way. Angles are those of the commands [rad], 0 = open;
the spread is not limited, it has no cells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from leap_hand.config import FINGERS, HandConfig

FEELING = FINGERS[:3]
"""Fingers with tactile cells, in the order of the commands and of the hand's state."""
NEVER_HEARD = "no state of the robot hand came yet: no finger closes"


@dataclass(frozen=True)
class HandState:
    """What the robot hand felt.

    Attributes:
        angles: of index, middle, thumb [rad].
        pressures: nine cells each [counts].
        loads: of their motors, closing positive [0.1 % of the largest torque].
    """

    angles: tuple[float, ...]
    pressures: tuple[tuple[float, ...], ...]
    loads: tuple[float, ...]


@dataclass(frozen=True)
class LimitedCommand:
    """What may be sent.

    Attributes:
        command: angles of index, middle, thumb, spread, shape (4,) [rad].
        limited: why a finger is limited, by its name.
        silence: why all fingers are held, as a sentence, or empty.
    """

    command: np.ndarray
    limited: dict[str, str]
    silence: str


class ForceLimit:
    """The limit with its state.

    Args:
        config: limits.

    Attributes:
        trips: how often a finger was stopped.
    """

    def __init__(self, config: HandConfig) -> None:
        self._config = config
        self._heard: float | None = None
        self._why: dict[str, str] = {}
        self._most = [math.inf] * len(FEELING)
        self._sent = [0.0] * len(FEELING)
        self.trips = 0

    def feel(self, state: HandState, now: float) -> bool:
        """Takes the state of the robot hand in.

        Args:
            state: the newest one; numbers that are not finite are no state.
            now: time of its arrival, on a clock that never jumps [s].

        Returns:
            Whether a finger was stopped that was free before.
        """
        if not self._config.force_limit:
            return False
        numbers = [*state.angles, *state.loads, *(count for cells in state.pressures for count in cells)]
        if not all(math.isfinite(number) for number in numbers):
            return False
        self._heard = now
        trips = self.trips
        for i, finger in enumerate(FEELING):
            cells = state.pressures[i]
            cell = max(range(len(cells)), key=cells.__getitem__)
            shares = (cells[cell] / self._config.force_limit_pressure, state.loads[i] / self._config.force_limit_load)
            if max(shares) > 1.0:
                if finger not in self._why:
                    self.trips += 1
                    self._most[i] = min(self._sent[i], state.angles[i])
                self._why[finger] = (
                    f"cell {cell}: {cells[cell]:.0f} counts" if shares[0] > 1.0 else f"load {state.loads[i]:.0f}"
                )
            elif max(shares) < self._config.force_limit_release and finger in self._why:
                del self._why[finger]
                self._most[i] = math.inf
        return self.trips > trips

    def clip(self, command: Sequence[float], now: float) -> LimitedCommand:
        """Returns what may be sent of a command: angles of index, middle, thumb, spread, shape (4,) [rad]."""
        allowed = np.array(command, dtype=float)
        if not self._config.force_limit:
            return LimitedCommand(read_only(allowed), {}, "")
        silence = self._silence(now)
        for i, finger in enumerate(FEELING):
            if silence:
                allowed[i] = min(allowed[i], self._sent[i])
            allowed[i] = min(allowed[i], self._most[i])
            if finger in self._why:
                self._most[i] = allowed[i]
            self._sent[i] = float(allowed[i])
        return LimitedCommand(read_only(allowed), dict(self._why), silence)

    def _silence(self, now: float) -> str:
        if self._heard is None:
            return NEVER_HEARD
        if now - self._heard <= self._config.force_limit_silence:
            return ""
        return "the state of the robot hand is not known: no finger closes further"
