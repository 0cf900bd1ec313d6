"""A bad link on loopback: a proxy that delays what passes in each direction, and loses packets as TCP repairs them.

Called as a program it prints its port and serves one client: `bad_link.py PORT DELAY JITTER LOSS`, times in seconds.
"""

from __future__ import annotations

import math
import random
import selectors
import socket
import sys
import time
from collections import deque

RTO_S = 0.2  # TCP repeats a lost packet after this time,
LATER = 3  # or at once if so many later ones have arrived


class Way:
    """One direction: chunks of bytes arrive in order, `delay` +- `jitter` [s] after they were sent.

    Of the chunks a fraction `loss` is lost: those behind it wait until it is repeated.
    """

    def __init__(self, delay: float, jitter: float, loss: float) -> None:
        self._delay, self._jitter, self._loss = delay, jitter, loss
        self._chunks: deque[tuple[float, bytes]] = deque()
        self._repeated, self._later = 0.0, 0

    def put(self, data: bytes, now: float) -> None:
        """Takes bytes that are sent at the time `now` [s]."""
        delay = self._delay + random.uniform(-self._jitter, self._jitter)
        self._later += 1
        if self._repeated > now:
            if self._later == LATER:
                self._repeated = min(self._repeated, now + 3.0 * delay)
        elif random.random() < self._loss:
            self._repeated, self._later = now + RTO_S + delay, 0
        self._chunks.append((now + delay, data))

    def due(self) -> float:
        """Returns when the next bytes arrive [s]; infinity where no bytes wait."""
        return max(self._chunks[0][0], self._repeated) if self._chunks else math.inf

    def take(self, now: float) -> bytes:
        """Returns the bytes that have arrived by the time `now` [s]."""
        data = b""
        while self.due() <= now:
            data += self._chunks.popleft()[1]
        return data


def main(port: int, delay: float, jitter: float, loss: float) -> None:
    """Serves one client until one of the two ends closes."""
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    client, _ = listener.accept()
    server = socket.create_connection(("127.0.0.1", port))
    ways = {client: (server, Way(delay, jitter, loss)), server: (client, Way(delay, jitter, loss))}
    with selectors.DefaultSelector() as selector:
        for end in ways:
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            selector.register(end, selectors.EVENT_READ)
        while True:
            wait = min(way.due() for _, way in ways.values()) - time.monotonic()
            for key, _ in selector.select(min(max(wait, 0.0), 1.0)):
                data = key.fileobj.recv(65536)  # type: ignore[union-attr]
                if not data:
                    return
                ways[key.fileobj][1].put(data, time.monotonic())  # type: ignore[index]
            for other, way in ways.values():
                data = way.take(time.monotonic())
                if data:
                    other.sendall(data)


if __name__ == "__main__":
    main(int(sys.argv[1]), *map(float, sys.argv[2:5]))
