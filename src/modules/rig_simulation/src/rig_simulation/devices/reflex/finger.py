"""The electronics of a finger: its knuckle encoder and its taxels."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

from rig_simulation.devices.reflex.mechanics import KNUCKLE_FRACTION, TAXELS

ENCODER_COUNTS = 16384
LIGHTEST_REST = 110
HEAVIEST_REST = 170
LEAST_COUNT = 56
MOST_COUNT = 310


class Finger:
    """The sensors of one finger, with the effects of the control port.

    Args:
        rng: source of its individual values and of the noise.
    """

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._encoder_zero = rng.randrange(ENCODER_COUNTS)
        self._rest = [rng.randint(LIGHTEST_REST, HEAVIEST_REST) for _ in range(TAXELS)]
        self._pressed = [0] * TAXELS
        self._stuck_count: int | None = None
        self._obstacle: float | None = None
        self._stiffness = 0.0

    def block(self, proximal: float | None, stiffness: float) -> None:
        """Sets an obstacle at a proximal angle [rad], or None; `stiffness` in 0.1 % of load per rad of the spool."""
        self._obstacle, self._stiffness = proximal, stiffness

    def resistance(self, spool: float) -> float:
        """Returns the effort against the obstacle [0.1 %]."""
        if self._obstacle is None:
            return 0.0
        return self._stiffness * max(0.0, spool - self._obstacle / KNUCKLE_FRACTION)

    def encoder(self, proximal: float) -> int:
        """Returns the encoder count at a turn of the knuckle [rad]: closing lowers it, with wrap-around."""
        if self._stuck_count is not None:
            return self._stuck_count
        count = self._encoder_zero - proximal / (2 * math.pi) * ENCODER_COUNTS + self._rng.randint(-1, 1)
        return round(count) % ENCODER_COUNTS

    def stick(self, on: bool, proximal: float) -> None:
        """Lets the encoder stick at its count for this turn of the knuckle [rad], or work again."""
        self._stuck_count = None
        if on:
            self._stuck_count = self.encoder(proximal)

    def press(self, taxel: int | None, value: int) -> None:
        """Presses one taxel, or all, by `value` counts."""
        for i in range(TAXELS) if taxel is None else [taxel]:
            self._pressed[i] = value

    def pressures(self, touch: Sequence[float]) -> list[int]:
        """Returns the counts of the nine taxels; `touch`: additional pressure [counts]."""
        counts = [
            round(rest + pressed + touched) + self._rng.randint(-1, 1)
            for rest, pressed, touched in zip(self._rest, self._pressed, touch)
        ]
        return [max(LEAST_COUNT, min(MOST_COUNT, c)) for c in counts]
