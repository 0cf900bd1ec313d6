"""Messages and requests of any type, with any values that their fields can hold."""

from __future__ import annotations

import math
import random
import re
from typing import Any

from genpy import Duration, Time
from roslib.message import get_message_class

from common import clock
from fuzz.mutations import NASTY

FRAMES = (
    "kuka/base_frame",
    "kuka/tool_frame/desired",
    "leap_motion/virtual_frame",
    "/kuka/flange_frame/desired",
    "x",
    "",
)


def random_message(kind: type, rng: random.Random) -> Any:
    """Returns a message or request of a type, with any values that its fields can hold."""
    return kind(*(_value(name, rng) for name in kind._slot_types))


def _value(name: str, rng: random.Random) -> Any:
    if name.endswith("]"):
        item, _, length = name[:-1].partition("[")
        count = int(length) if length else rng.choice((0, 1, 2, 7, 30))
        if item in ("uint8", "char"):
            return bytes(rng.randrange(256) for _ in range(count))
        return [_value(item, rng) for _ in range(count)]
    if name == "bool":
        return rng.random() < 0.5
    if name == "string":
        text = rng.choice((*FRAMES, *(v for v in NASTY if isinstance(v, str))))
        return text.encode("utf-8", "replace").decode()
    if name in ("time", "duration"):
        now = clock.time() if name == "time" else 0.0
        stamp = (Time if name == "time" else Duration).from_sec(now + rng.choice((0.0, 0.0, -1.0, 0.4, 1e3)))
        return stamp if rng.random() < 0.8 else type(stamp)()
    if name.startswith("float"):
        value = rng.choice((*(v for v in NASTY if isinstance(v, float)), rng.uniform(-1.0, 1.0), rng.gauss(0.0, 100.0)))
        return value if name == "float64" or not abs(value) > 3e38 or math.isinf(value) else math.inf
    if re.fullmatch(r"u?int\d+|byte|char", name):
        bits = int("".join(filter(str.isdigit, name)) or 8)
        low = 0 if name.startswith("u") or name == "char" else -(2 ** (bits - 1))
        return rng.choice((low, low + 2**bits - 1, 0, 1, 2, rng.randrange(low, low + 2**bits)))
    return random_message(get_message_class("std_msgs/Header" if name == "Header" else name), rng)
