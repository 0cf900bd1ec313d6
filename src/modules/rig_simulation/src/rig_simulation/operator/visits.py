"""When the operator's hand leaves the view to come in again: an arm that does not follow needs a new start."""

from __future__ import annotations

UNFOLLOWED_S, LOST_S, MOST = 8.0, 2.0, 3
"""Patience with an arm that does not follow yet, and with one that no longer does; most visits."""


class Visits:
    """Counts how often the hand came into view. Times in seconds."""

    def __init__(self) -> None:
        self.count = 0
        self._since, self._patience = 0.0, UNFOLLOWED_S

    def enter(self, now: float) -> None:
        self.count += 1
        self._since, self._patience = now, UNFOLLOWED_S

    def over(self, following: bool, now: float) -> bool:
        if following:
            self._since, self._patience = now, LOST_S
        return now - self._since > self._patience and self.count < MOST
