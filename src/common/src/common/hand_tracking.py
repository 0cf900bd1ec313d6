"""Whether the stream of tracking frames is alive, and which of the hands in view is the operator's.

Times are seconds of a monotonic clock; only `age`, arrival less the frame's stamp, uses the clock of the stamps.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, TypeVar

MAX_SKEW_S = 0.5  # how far a frame's stamp may be from the present time [s]


@dataclass(frozen=True)
class FrameArrival:
    """The verdict on a frame."""

    usable: bool  # whether it is new and of the present; otherwise it must be ignored
    broken: str | None = None  # why it must not continue the stream before it


class FrameWatch:
    """Judges each frame by its number, its age and the time since the frame before; the stream is broken after more
    than `max_silence` [s] without a usable frame.
    """

    def __init__(self, max_silence: float) -> None:
        self._max_silence = max_silence
        self._last_id: int | None = None
        self._last_time: float | None = None
        self._refusal: tuple[str, float] | None = None

    def arrived(self, frame_id: int, age: float, now: float) -> FrameArrival:
        """Judges a frame that arrived at `now` [s], `age` [s] after its stamp. A repeated number means that the tracker
        hangs: the frame is ignored, and the silence continues. A lower number means that the tracker has restarted.
        """
        if not abs(age) <= MAX_SKEW_S:
            skewed = f"the stamps of the tracking frames are {abs(age):.1f} s {'old' if age > 0 else 'in the future'}"
            self._refusal = (skewed, now)
            return FrameArrival(False, skewed)
        if frame_id == self._last_id:
            self._refusal = (f"the tracker repeats frame {frame_id}", now)
            return FrameArrival(False)
        broken = None
        if self._last_id is not None and frame_id < self._last_id:
            broken = f"the tracker's frame number went back from {self._last_id} to {frame_id}"
        elif self._last_time is not None and now - self._last_time > self._max_silence:
            broken = f"no tracking frame came for {now - self._last_time:.1f} s"
        self._last_id, self._last_time = frame_id, now
        return FrameArrival(True, broken)

    def silence(self, now: float) -> str | None:
        """Returns why no usable frame came for longer than `max_silence`, or None where one came."""
        if self._last_time is not None and now - self._last_time <= self._max_silence:
            return None
        if self._refusal is not None and now - self._refusal[1] <= self._max_silence:
            return self._refusal[0]
        return "no tracking frames come in"


class Identified(Protocol):
    """A hand: the tracker's number of it, and its side."""

    @property
    def id(self) -> int: ...
    @property
    def is_left(self) -> bool: ...


Hand = TypeVar("Hand", bound=Identified)


class HandChoice:
    """Chooses the hand that has been visible longest; one that is missing in a frame counts as new afterwards.

    The reported visible time is unreliable (early Leap services put the service's uptime there), so the order of
    appearance is kept here. A hand whose side changes was mistaken for another one.
    """

    def __init__(self) -> None:
        self._visible: list[tuple[int, bool]] = []

    def choose(self, hands: Iterable[Hand]) -> Hand | None:
        """Returns the hand of a frame that has been visible longest, or None without a hand.

        Of hands that appear in the same frame, the lower id counts as older: the tracker counts its ids upwards.
        """
        visible = {(hand.id, hand.is_left): hand for hand in hands}
        staying = [key for key in self._visible if key in visible]
        self._visible = staying + sorted(key for key in visible if key not in staying)
        return visible[self._visible[0]] if self._visible else None
