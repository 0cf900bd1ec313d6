"""The stream of desired tool frames: which one is new, which is refused, and how long none has come.

Times are of two clocks: stamps and `clock` are ROS time; `now` is monotonic, so that a wall clock that is set does not
look like a time-out.
"""

from __future__ import annotations

from dataclasses import dataclass

from kuka_control.model.desired_frame import DesiredFrame, rejection_reason

MAX_SKEW_S = 0.5
"""How far a stamp may be from the clock [s]."""

REFUSING_S = 0.5
"""Frames count as refused until so long after the last one that was [s]."""


@dataclass(frozen=True)
class StreamUpdate:
    """What the stream made of the newest desired tool frame.

    Attributes:
        fresh: the frame, if it is new and good.
        refused: a sentence, the first time that a frame is refused in a row; else None.
    """

    fresh: DesiredFrame | None = None
    refused: str | None = None


class DesiredStream:
    """Watches the newest desired tool frame."""

    def __init__(self) -> None:
        self._seen: float | None = None
        self._last_good: float | None = None
        self._refusing = False
        self._refusal: tuple[str, float] | None = None

    def take(self, newest: DesiredFrame | None, clock: float, now: float) -> StreamUpdate:
        """Looks at the newest frame: only one whose stamp differs from the one before is new.

        Args:
            newest: the newest frame there is, or None.
            clock: ROS time [s].
            now: monotonic time [s].
        """
        if newest is None or newest.stamp == self._seen:
            return StreamUpdate()
        self._seen = newest.stamp
        fault = _fault(newest, clock)
        if fault is None:
            self._refusing = False
            self._refusal = None
            self._last_good = now
            return StreamUpdate(newest)
        said, self._refusing = self._refusing, True
        self._refusal = (fault, now)
        return StreamUpdate(refused=None if said else fault)

    def refusal(self, now: float) -> str | None:
        """Returns why the frames that come in are refused, a sentence; None if they are not, or none come."""
        return self._refusal[0] if self._refusal and now - self._refusal[1] <= REFUSING_S else None

    def silent_for(self, now: float) -> float:
        """Returns how long no new good frame has come [s]; infinite when none ever came."""
        return float("inf") if self._last_good is None else now - self._last_good


def _fault(desired: DesiredFrame, clock: float) -> str | None:
    if desired.conflict is not None:
        return desired.conflict
    skew = desired.stamp - clock
    if abs(skew) > MAX_SKEW_S:
        side = "ahead of" if skew > 0.0 else "behind"
        return (
            f"The desired tool frame is refused: its stamp is {abs(skew):.3f} s {side} this machine's clock, more than "
            f"{MAX_SKEW_S:g} s; it is old, or the clocks of the machines differ."
        )
    reason = rejection_reason(desired.T_base_tool)
    return None if reason is None else f"The desired tool frame is refused: {reason}"
