"""How fast the time of the simulated world passes."""

from __future__ import annotations

from collections import deque

WINDOW_S = 5.0


class Pace:
    """Compares the world's time with everybody else's over the last WINDOW_S."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float]] = deque()

    def see(self, world: float, now: float) -> None:
        """Takes the world's time at the time `now` in [s]; a world that began anew is compared anew."""
        if self._seen and world < self._seen[-1][0]:
            self._seen.clear()
        self._seen.append((world, now))
        while self._seen[-1][1] - self._seen[0][1] > WINDOW_S:
            self._seen.popleft()

    @property
    def factor(self) -> float | None:
        """Seconds of the world in a second; None before there are two moments to compare."""
        if len(self._seen) < 2 or self._seen[-1][1] == self._seen[0][1]:
            return None
        (world_before, before), (world, now) = self._seen[0], self._seen[-1]
        return (world - world_before) / (now - before)
