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


def ports_of_a_rig() -> dict[str, int]:
    """Returns a free port for each argument of demo.launch that names one."""
    tcp = ("robot", "robot_control", "hand_control", "leap", "leap_control", "world", "camera_control")
    return {**{f"{name}_port": free_port() for name in tcp}, "hand_port": free_port(socket.SOCK_DGRAM)}
