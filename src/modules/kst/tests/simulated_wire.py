"""A transport in simulated time, on which the laws of the client stand: lines arrive when they are due."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from kst.codec import parse_reply
from kst.errors import ConnectionLost


class SimulatedWire:
    """A server puts its lines on it; none arrives before `stalled_until`. `sent`: times and first words of the client's
    lines.
    """

    def __init__(self):
        self.now, self.stalled_until = 1000.0, 0.0
        self.sent = []
        self.lost = self.ended_by_peer = False
        self._count, self._wire = itertools.count(), []

    def put(self, text, due):
        heapq.heappush(self._wire, (due, next(self._count), text))

    def monotonic(self):
        return self.now

    def receive(self, deadline):
        self.check()
        due = self._due()
        if due <= max(deadline, self.now):
            self.now = max(self.now, due)
            return self._next()
        self.now = max(self.now, deadline)
        return None

    def waiting(self):
        self.check()
        replies = []
        while self._due() <= self.now:
            replies.append(self._next())
        return replies

    def pause(self, duration):
        self.now += duration

    def give_up(self, reason):
        self.lost = True
        self.check()

    def reopen(self):
        self.lost = False

    def end_writing(self):
        pass

    def close(self):
        self.lost = True

    def check(self):
        if self.lost:
            raise ConnectionLost("given up")

    def _due(self):
        return max(self._wire[0][0], self.stalled_until) if self._wire else np.inf

    def _next(self):
        return parse_reply(heapq.heappop(self._wire)[2].encode())
