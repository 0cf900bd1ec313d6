"""How far the clock that stamps the desired tool frame is from this machine's, where the frame comes from another one.

Nothing tells a clock that differs from a frame that is late, except that a late one does not stay equally late. So an
offset counts once stamps that change have kept it for STEADY_S; the least late of them gives it. A backlog that arrives
at once, a frame that is repeated, and a clock that was set do not keep it. Times in s; `now` is monotonic.
"""

from __future__ import annotations

from dataclasses import dataclass

from kuka_control.model.desired_frame import MAX_OFFSET_S, MAX_SKEW_S, STEADY_S

STEADY_COUNT = 5  # so many stamps at least
SPREAD_S = 0.25  # among them stamps are not further apart in lateness than this
DRIFT = 1e-4  # an offset that was measured follows the other clock at this rate at most [s/s]


@dataclass
class _Candidate:
    """Stamps that disagree with the offset so far: since when, by how much at least and at most, and how many."""

    since: float
    low: float
    high: float
    count: int = 1


class ClockOffset:
    """The offset of one node's clock.

    Attributes:
        value: its stamps less this machine's clock [s]; 0 while they agree within MAX_SKEW_S.
        number: how often it was measured.
    """

    def __init__(self) -> None:
        self.value, self.number = 0.0, 0
        self._last: float | None = None
        self._agreed: float | None = None  # when a stamp did last
        self._candidate: _Candidate | None = None

    def take(self, stamp: float, clock: float, now: float) -> bool:
        """Takes a stamp as it came at the ROS time `clock`; returns whether the offset is another one from it on."""
        before, self._last = self._last, stamp
        if stamp == before:
            return False
        skew = stamp - clock
        if abs(skew - self.value) <= MAX_SKEW_S:
            self._candidate = None
            if self.value and self._agreed is not None:
                most = DRIFT * max(now - self._agreed, 0.0)
                self.value += min(max(skew - self.value, -most), most)
            self._agreed = now
            return False
        return self._measured(before is not None and stamp > before, skew, now)

    def _measured(self, advanced: bool, skew: float, now: float) -> bool:
        found = self._candidate
        low, high = (skew, skew) if found is None else (min(found.low, skew), max(found.high, skew))
        if found is None or not advanced or high - low > SPREAD_S:
            self._candidate = _Candidate(now, skew, skew)
            return False
        found.low, found.high, found.count = low, high, found.count + 1
        if now - found.since < STEADY_S or found.count < STEADY_COUNT or max(-low, high) > MAX_OFFSET_S:
            return False
        self.value, self.number = (0.0 if abs(high) <= MAX_SKEW_S else high), self.number + 1
        self._candidate, self._agreed = None, now
        return True
