"""Messages that wait until they are due, in their order."""

from __future__ import annotations

import math
from collections import deque
from typing import Generic, TypeVar

Message = TypeVar("Message")


class DelayLine(Generic[Message]):
    """A queue with a time for each message; none overtakes another, as in one cable. Time is handed in."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[float, Message]] = deque()

    def put(self, message: Message, due: float) -> None:
        """Takes a message that is due at a time [s], or when those before it have gone."""
        before = self._waiting[-1][0] if self._waiting else -math.inf
        self._waiting.append((max(due, before), message))

    def take(self, now: float) -> list[Message]:
        """Returns the messages that are due by the time `now` [s]."""
        due = []
        while self._waiting and self._waiting[0][0] <= now:
            due.append(self._waiting.popleft()[1])
        return due

    def next_due(self) -> float:
        """Returns when the next message is due [s]; infinity if none waits."""
        return self._waiting[0][0] if self._waiting else math.inf

    def clear(self) -> None:
        """Forgets what waits."""
        self._waiting.clear()
