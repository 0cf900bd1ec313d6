"""The rate of a stream of frames by their stamps."""

from __future__ import annotations

from collections import deque


class FrameRate:
    """Counts frames over the last `window` [s] at least: from the newest stamp that is older, so that bursts of frames
    do not count as a fast stream."""

    def __init__(self, window: float) -> None:
        self._window = window
        self._stamps: deque[float] = deque()

    def take(self, stamp: float) -> None:
        """Takes the stamp of a frame [s], which is not older than the one before."""
        stamps = self._stamps
        stamps.append(stamp)
        while len(stamps) > 1 and stamp - stamps[1] >= self._window:
            stamps.popleft()

    def clear(self) -> None:
        self._stamps.clear()

    @property
    def last(self) -> float | None:
        """The newest stamp [s]; None before the first frame."""
        return self._stamps[-1] if self._stamps else None

    @property
    def span(self) -> float:
        """Time between the first and the last of the frames that count [s]."""
        return self._stamps[-1] - self._stamps[0] if self._stamps else 0.0

    @property
    def value(self) -> float | None:
        """Frames per second [Hz]; None while there are too few."""
        fewest = 3  # frames that have a rate
        if len(self._stamps) < fewest or self.span <= 0.0:
            return None
        return (len(self._stamps) - 1) / self.span
