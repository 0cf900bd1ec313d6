"""A finger: a tendon spool turns it at the knuckle and bends its outer link. Angles in rad, 0 = open.

While nothing is in the way the knuckle takes 1/1.4 of the tendon's turn and the outer link the rest; once the inner
link is blocked, the outer link takes all of it.
"""

from __future__ import annotations

import math
import random

KNUCKLE_SHARE = 1 / 1.4
MAX_SPOOL_RAD = 4.0
ENCODER_COUNTS = 16384
CELLS = 9
LIGHTEST_REST = 110
HEAVIEST_REST = 170
LEAST_COUNT = 56
MOST_COUNT = 310


class Finger:
    """One finger with its knuckle encoder and tactile cells.

    Args:
        rng: source of its individual values and of noise.
    """

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._encoder_zero = rng.randrange(ENCODER_COUNTS)
        self._rest = [rng.randint(LIGHTEST_REST, HEAVIEST_REST) for _ in range(CELLS)]
        self._pressed = [0] * CELLS
        self._stuck_count: int | None = None
        self.obstacle: float | None = None
        self.obstacle_stiffness = 0.0
        self.proximal = 0.0
        self.distal = 0.0

    def flex(self, spool: float) -> None:
        """Takes the pose for a spool angle [rad]; below 0 the tendon is slack."""
        tendon = max(0.0, spool)
        self.proximal = min(tendon * KNUCKLE_SHARE, math.pi, self.obstacle if self.obstacle is not None else math.pi)
        self.distal = tendon - self.proximal

    def resistance(self, spool: float) -> float:
        """Returns the effort [0.1 %] that the obstacle takes."""
        if self.obstacle is None:
            return 0.0
        return self.obstacle_stiffness * max(0.0, spool - self.obstacle / KNUCKLE_SHARE)

    def encoder(self) -> int:
        """Returns the encoder's count: closing lowers it, and it goes through its end."""
        if self._stuck_count is not None:
            return self._stuck_count
        count = self._encoder_zero - self.proximal / (2 * math.pi) * ENCODER_COUNTS + self._rng.randint(-1, 1)
        return round(count) % ENCODER_COUNTS

    def stick(self, on: bool) -> None:
        """Lets the encoder report its present count for ever, or work again."""
        self._stuck_count = None
        if on:
            self._stuck_count = self.encoder()

    def press(self, cell: int | None, value: int) -> None:
        """Presses one cell, or all, by `value` counts."""
        for i in range(CELLS) if cell is None else [cell]:
            self._pressed[i] = value

    def pressures(self) -> list[int]:
        """Returns the counts of the nine cells."""
        counts = [r + p + self._rng.randint(-1, 1) for r, p in zip(self._rest, self._pressed)]
        return [max(LEAST_COUNT, min(MOST_COUNT, c)) for c in counts]
