"""Free ports for programs that get their port before they open it: tests and benchmarks."""

from __future__ import annotations

import random
import socket

FIRST, LAST = 15000, 29999  # below the ports from 32768 on, which Linux gives to outgoing connections and for port 0
TRIES = 200


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Returns a free loopback port of TCP (`SOCK_STREAM`) or UDP (`SOCK_DGRAM`); raises OSError if none was found."""
    generator = random.SystemRandom()
    for _ in range(TRIES):
        port = generator.randint(FIRST, LAST)
        with socket.socket(socket.AF_INET, kind) as s:
            try:
                s.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"{TRIES} random ports between {FIRST} and {LAST} are all in use")
