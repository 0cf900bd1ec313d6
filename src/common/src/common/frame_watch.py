"""Whether a stream of tracking frames is alive: frames are new, carry the present time and leave no long gap.

Times are seconds of a monotonic clock; only `age`, the time of arrival less the frame's stamp, uses the clock of the
stamps.
"""

from __future__ import annotations

from dataclasses import dataclass

MAX_SKEW_S = 0.5
"""How far a frame's stamp may be from the present time [s]."""


@dataclass(frozen=True)
class FrameArrival:
    """The verdict on a frame.

    Attributes:
        usable: whether it is new and of the present; otherwise it must be ignored.
        broken: why it must not continue the stream before it, or None.
    """

    usable: bool
    broken: str | None = None


class FrameWatch:
    """Judges each frame by its number, its age and the time since the frame before.

    Args:
        max_silence: longest time without a usable frame [s].
    """

    def __init__(self, max_silence: float) -> None:
        self._max_silence = max_silence
        self._last_id: int | None = None
        self._last_time: float | None = None
        self._refusal: tuple[str, float] | None = None

    def arrived(self, frame_id: int, age: float, now: float) -> FrameArrival:
        """Judges a frame.

        A repeated number means that the tracker hangs: the frame is ignored, and the silence continues. A lower number
        means that the tracker has restarted.

        Args:
            frame_id: number of the frame.
            age: time of arrival less the frame's stamp [s].
            now: time of arrival [s].
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

    def reset(self) -> None:
        """Forgets all frames."""
        self._last_id = self._last_time = self._refusal = None
