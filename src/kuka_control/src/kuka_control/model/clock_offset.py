"""How far the clock of another machine is from this one's [s], by a two-way exchange: asked at `sent`, answered at
`received`, the other clock showed the `stated` second meanwhile. No delay on the way is taken for an offset: each
answer bounds it from both sides, most closely just before and just after a second of the other clock ends."""

from __future__ import annotations

import math

from kuka_control.numbers import MAX_OFFSET_S

SECOND_S = 1.0  # an answer says the other clock's whole second
WIDTH_S = 0.25  # an offset that is known to this is known
DRIFT = 1e-4  # a clock gains or loses this much at most [s/s]


class OffsetMeasurement:
    """One measurement, of several answers."""

    def __init__(self) -> None:
        self._low = -math.inf
        self._high = math.inf

    def answered(self, sent: float, received: float, stated: float) -> None:
        """Takes an answer; one that contradicts those before begins anew: a clock was set."""
        low, high = stated - received, stated + SECOND_S - sent
        if max(self._low, low) > min(self._high, high):
            self._low, self._high = low, high
        self._low, self._high = max(self._low, low), min(self._high, high)

    @property
    def offset(self) -> float | None:
        """The other clock less this one, to half of WIDTH_S [s]; None while it is not known so well."""
        return (self._low + self._high) / 2.0 if self._high - self._low <= WIDTH_S else None


class ClockOffset:
    """The offset of one node's clock, by which the stamps of its frames are corrected: `value`, the other clock less
    this machine's [s], 0 where they agree to what can be measured; `number` counts how often another one was
    measured."""

    def __init__(self) -> None:
        self.value = 0.0
        self.number = 0
        self._measured = 0.0
        self._at = -math.inf

    def measured(self, offset: float) -> bool:
        """Takes a new measurement; returns whether the offset is another one from it on. One within WIDTH_S is taken
        over little by little, and one beyond MAX_OFFSET_S not at all."""
        offset = offset if WIDTH_S < abs(offset) <= MAX_OFFSET_S else 0.0
        self._measured = offset
        if abs(offset - self.value) <= WIDTH_S:
            return False
        self.value, self.number = offset, self.number + 1
        return True

    def pass_to(self, now: float) -> None:
        """Follows the other clock's drift up to the monotonic time `now`."""
        most = DRIFT * max(now - self._at, 0.0) if self._at > -math.inf else 0.0
        self.value += min(max(self._measured - self.value, -most), most)
        self._at = now
