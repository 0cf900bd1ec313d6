"""A queue of messages that wait until they are due, and bytes as a broken cable would send them."""

from __future__ import annotations

import math
import random
from collections import deque
from typing import Generic, TypeVar

Message = TypeVar("Message")


class DelayLine(Generic[Message]):
    """A queue with a due time for each message; no message overtakes another, as in one cable. Time is handed in."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, Message]] = deque()

    def put(self, message: Message, due: float) -> None:
        """Takes a message that is due at a time [s], or as soon as those before it have left."""
        self._waiting.append((max(due, self._waiting[-1][0] if self._waiting else -math.inf), message))

    def take(self, now: float) -> list[Message]:
        """Returns the messages that are due by the time `now` [s]."""
        due = []
        while self.next_due() <= now:
            due.append(self._waiting.popleft()[1])
        return due

    def next_due(self) -> float:
        """Returns when the next message is due [s]; infinity for an empty queue."""
        return self._waiting[0][0] if self._waiting else math.inf

    def clear(self) -> None:
        """Drops all messages."""
        self._waiting.clear()


def garbled(data: bytes, rng: random.Random) -> bytes:
    """Returns the same number of bytes, each of them changed."""
    return bytes((byte + rng.randrange(1, 256)) % 256 for byte in data)
