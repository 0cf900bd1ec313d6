"""The one clock of the world."""

from __future__ import annotations

import time


class Clock:
    """Time of the world [s].

    Args:
        speed: seconds of the world in a second; None: it moves only by `move`.

    With speed 1 it equals the system's monotonic clock, with another speed it does not.
    """

    def __init__(self, speed: float | None) -> None:
        self.speed = speed
        self._start = time.monotonic() if speed is not None else 0.0

    @property
    def stepped(self) -> bool:
        """Whether it moves only by `move`."""
        return self.speed is None

    def __call__(self) -> float:
        """Returns the time."""
        if self.speed is None:
            return self._start
        return self._start + (time.monotonic() - self._start) * self.speed

    def move(self, seconds: float) -> None:
        """Advances the clock.

        Raises:
            ValueError: the clock runs by itself.
        """
        if not self.stepped:
            raise ValueError("The world's clock runs by itself; start the world with --stepped to step it.")
        self._start += seconds
