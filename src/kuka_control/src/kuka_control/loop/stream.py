"""The stream of desired tool frames: which frame is new, which is refused, and for how long none has come.

Times are of two clocks: stamps and `clock` are ROS time; `now` is monotonic, so that setting the wall clock does not
look like a time-out.
"""

from __future__ import annotations

from dataclasses import dataclass

from kuka_control.model.desired_frame import DesiredFrame, rejection_reason

MAX_SKEW_S = 0.5
"""How far a stamp may be from the clock [s]."""

REFUSING_S = 0.5
"""Frames count as refused until this long after the last refused one [s]."""


@dataclass(frozen=True)
class StreamUpdate:
    """The verdict on the newest desired tool frame."""

    fresh: DesiredFrame | None = None
    """The frame, if it is new and accepted."""
    refused: str | None = None
    """Why it is refused, a sentence, for the first refused frame in a row."""


class DesiredStream:
    """Watches the newest desired tool frame."""

    def __init__(self) -> None:
        self._last_stamp: float | None = None
        self._last_good: float | None = None
        self._refusing = False
        self._refusal: tuple[str, float] | None = None

    def take(self, newest: DesiredFrame | None, clock: float, now: float) -> StreamUpdate:
        """Checks the newest frame at the ROS time `clock` [s] and the monotonic time `now` [s].

        A frame is new if its stamp differs from that of the frame before.
        """
        if newest is None or newest.stamp == self._last_stamp:
            return StreamUpdate()
        self._last_stamp = newest.stamp
        fault = _fault(newest, clock)
        if fault is None:
            self._refusing = False
            self._refusal = None
            self._last_good = now
            return StreamUpdate(newest)
        reported, self._refusing = self._refusing, True
        self._refusal = (fault, now)
        return StreamUpdate(refused=None if reported else fault)

    def refusal(self, now: float) -> str | None:
        """Returns why incoming frames are refused, a sentence; None if they are accepted, or none come."""
        return self._refusal[0] if self._refusal and now - self._refusal[1] <= REFUSING_S else None

    def silent_for(self, now: float) -> float:
        """Returns the time since the last accepted frame [s]; infinite before the first."""
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
