"""The one clock of the world, and its pace against real time."""

from __future__ import annotations

from collections import deque

from common import clock


class Clock:
    """Time of the world [s]: at speed 1 the system's monotonic clock, else `speed` seconds of the world in a second;
    with None it moves only by `move`."""

    def __init__(self, speed: float | None) -> None:
        self.speed = speed
        self._start = clock.monotonic() if speed is not None else 0.0

    def __call__(self) -> float:
        return self._start + (0.0 if self.speed is None else (clock.monotonic() - self._start) * self.speed)

    def move(self, seconds: float) -> None:
        """Advances the clock; raises ValueError if it runs by itself."""
        if self.speed is not None:
            raise ValueError("The world's clock runs by itself; start the world with --stepped to step it.")
        self._start += seconds


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
