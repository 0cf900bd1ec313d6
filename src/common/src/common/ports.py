"""Ports for programs that are told their port before they open it: tests and benchmarks."""

from __future__ import annotations

import random
import socket

FIRST = 15000
LAST = 29999
"""Below the ports that Linux (32768 on) gives to outgoing connections and for port 0: such a port could be taken by any
other program before the one that it is meant for opens it.
"""

TRIES = 200


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Returns a port of this machine's loopback address that is free now.

    Args:
        kind: `SOCK_STREAM` for TCP, `SOCK_DGRAM` for UDP.

    Raises:
        OSError: all that were tried are in use.
    """
    generator = random.SystemRandom()
    for _ in range(TRIES):
        port = generator.randint(FIRST, LAST)
        with socket.socket(socket.AF_INET, kind) as s:
            try:
                s.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(f"none of {TRIES} ports between {FIRST} and {LAST} is free")
