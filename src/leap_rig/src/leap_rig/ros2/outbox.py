"""What a slow process gets: the newest frames of each source, in the order of their arrival, and not too many."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable

from common import clock


class NewestFrames:
    """Of each source at most `depth` frames wait; a newer one takes the place of its oldest."""

    def __init__(self) -> None:
        self._waiting: list[tuple[Hashable, bytes]] = []
        self._counts: Counter[Hashable] = Counter()
        self._changed = clock.Condition()
        self._closed = False
        self.dropped = 0

    def put(self, source: Hashable, frame: bytes, depth: int = 1) -> None:
        """Adds a frame; waits for nothing."""
        with self._changed:
            if self._closed:
                return
            if self._counts[source] >= depth:
                del self._waiting[next(i for i, (name, _) in enumerate(self._waiting) if name == source)]
                self._counts[source] -= 1
                self.dropped += 1
            self._waiting.append((source, frame))
            self._counts[source] += 1
            self._changed.notify()

    def take(self) -> bytes:
        """Waits for frames and returns all, one after the other; nothing once it is closed."""
        with self._changed:
            while not self._waiting and not self._closed:
                self._changed.wait()
            data = b"".join(frame for _, frame in self._waiting)
            self._waiting.clear()
            self._counts.clear()
            return data

    def close(self) -> None:
        """Ends `take`, which returns what still waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class MessageRateLimit:
    """Lets pass `rate` messages a second of each source, and `burst` at once, as after a pause of the machine."""

    def __init__(self, rate: float, burst: int) -> None:
        self._rate, self._burst = rate, burst
        self._room: dict[Hashable, tuple[float, float]] = {}  # how many may pass, and when that was so

    def passes(self, source: Hashable, now: float) -> bool:
        """Whether what came at `now` [s, monotonic] passes."""
        room, then = self._room.get(source, (self._burst, now))
        room = min(self._burst, room + self._rate * (now - then))
        passes = room >= 1.0
        self._room[source] = room - passes, now
        return passes
