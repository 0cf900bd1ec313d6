"""The real-time factor of the simulated world."""

from __future__ import annotations

from collections import deque

WINDOW_S = 5.0


class Pace:
    """Compares the world's time with real time over the last WINDOW_S."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque()

    def add(self, world: float, now: float) -> None:
        """Adds a sample [s]; a restarted world restarts the comparison."""
        if self._samples and world < self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((world, now))
        while self._samples[-1][1] - self._samples[0][1] > WINDOW_S:
            self._samples.popleft()

    @property
    def factor(self) -> float | None:
        """Seconds of the world in a second; None before the second sample."""
        if len(self._samples) < 2 or self._samples[-1][1] == self._samples[0][1]:
            return None
        (world_before, before), (world, now) = self._samples[0], self._samples[-1]
        return (world - world_before) / (now - before)
