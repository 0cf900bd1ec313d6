"""Subscribing only while messages are wanted."""

from __future__ import annotations

from collections.abc import Callable

from common.ros.service_calls import master_answers


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

    def follow(self, wanted: bool) -> None:
        """As a call, but changes nothing while the master does not answer: rospy waits for one that hangs, and nothing
        else of the node can subscribe then. For a thread of its own, as the master may hang just after its answer."""
        if wanted is not bool(self.subscribers) and master_answers():
            self(wanted)
