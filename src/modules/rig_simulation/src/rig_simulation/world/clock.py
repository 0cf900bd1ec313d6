"""The one clock of the world."""

from __future__ import annotations

import time


class Clock:
    """Time of the world [s].

    Args:
        speed: seconds of the world in a second; None: it stands until it is moved.

    Attributes:
        speed: as given.

    With speed 1 it is the system's monotonic clock; with another it is not, so ages are differences of its own times.
    """

    def __init__(self, speed: float | None) -> None:
        self.speed = speed
        self._start = time.monotonic() if speed is not None else 0.0

    @property
    def stepped(self) -> bool:
        """Whether it only moves when it is told to."""
        return self.speed is None

    def __call__(self) -> float:
        """Returns the time."""
        if self.speed is None:
            return self._start
        return self._start + (time.monotonic() - self._start) * self.speed

    def move(self, seconds: float) -> None:
        """Moves it on.

        Raises:
            ValueError: it runs by itself.
        """
        if not self.stepped:
            raise ValueError(
                "The world's clock runs by itself; only a world that was started with --stepped takes steps."
            )
        self._start += seconds
