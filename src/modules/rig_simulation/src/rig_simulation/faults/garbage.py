"""Bytes as a broken device or cable would send them."""

from __future__ import annotations

import random


def garbled(data: bytes, rng: random.Random) -> bytes:
    """Returns as many bytes, each of them another one."""
    return bytes((byte + rng.randrange(1, 256)) % 256 for byte in data)
