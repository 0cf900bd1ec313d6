"""Subscribing only while messages are wanted."""

from __future__ import annotations

from collections.abc import Callable


class OnDemand:
    """Called with whether messages are wanted, subscribes or unsubscribes: nobody need send what nobody wants."""

    def __init__(self, subscribe: Callable[[], list]) -> None:
        self._subscribe = subscribe
        self.subscribers: list = []

    def __call__(self, wanted: bool) -> None:
        if wanted and not self.subscribers:
            self.subscribers = self._subscribe()
        elif not wanted:
            for subscriber in self.subscribers:
                subscriber.unregister()
            self.subscribers = []
