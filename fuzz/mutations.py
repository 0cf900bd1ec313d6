"""Input that is nearly right: seeds with a few random edits, as bytes or as trees of JSON and yaml values.

Each edit is one whole number, from which it is made by a random generator, so hypothesis shrinks a finding to the few
edits that it needs, stores them, and needs little time for an example.
"""

from __future__ import annotations

import copy
import json
import math
import random
from collections.abc import Callable, Sequence
from typing import Any

from hypothesis import strategies as st

NASTY: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 255, 256, 65536, 2**31, -(2**31) - 1, 2**32, 2**53 + 1, 2**63, -(2**64), 10**400,
    0.0, -0.0, 0.5, -1.5, 1e-9, 5e-324, 1e9, 1e15, 1.7e308, -1.7e308, math.inf, -math.inf, math.nan,
    "", " ", "x", "nan", "inf", "0x10", "1e5", "right", "\ud800", "\0", "ü", "/", "~", "../x", "a" * 300,
    [], {}, [[]], [{}], [0] * 7, [0.0] * 3, [math.nan] * 3, {"x": 1}, {"": {}}, [[0, 0, 0]] * 3,
)  # fmt: skip
TOKENS = (
    b"_", b"\n", b"\r\n", b"\0", b"-", b".", b"E", b"e999", b"NaN", b"Infinity", b"-Infinity", b"nan", b"1e400",
    b"9" * 40, b"{", b"}", b"[", b"]", b"[" * 2000, b'{"a":' * 300, b",", b":", b'"', b"null", b"true", b"\xff",
    b"\xed\xa0\x80", b"\\ud800", b"<<: ", b"&a ", b"*a", b"!!python/none ", b"!!binary x", b"? ", b"- ",
    b"2001-13-45", b"=", b"0x", b"1:60", b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\x00\x00\xf0\x7f",
    b"\x00\x00\xf8\x7f", b"done\n", b"nak\n",
)  # fmt: skip
EDITS = st.lists(st.integers(0, 2**48 - 1), min_size=1, max_size=6)


def edited_bytes(seed: bytes, edits: Sequence[int], tokens: Sequence[bytes] = TOKENS) -> bytes:
    """Returns the bytes after the edits: bits flipped, ranges removed, repeated or moved, tokens put in."""
    data = bytearray(seed)
    for edit in edits:
        rng = random.Random(edit)
        at, length = rng.randrange(len(data) + 1), 1 + int(rng.expovariate(0.15))
        kind = rng.randrange(7)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 1 and data:
            data[at % len(data)] = rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))
        elif kind == 2:
            del data[at : at + length]
        elif kind == 3:
            data[at:at] = data[at : at + length] * rng.choice((1, 1, 2, 40))
        elif kind == 4:
            data[at : at + rng.choice((0, length))] = rng.choice(tokens)
        elif kind == 5:
            del data[at:]
        else:
            other = rng.randrange(len(data) + 1)
            data[at:at] = data[other : other + length]
    return bytes(data)


def edited_tree(tree: Any, edits: Sequence[int], nasty: Sequence[Any] = NASTY) -> Any:
    """Returns a copy of a tree of lists and mappings after the edits: values replaced, removed, repeated, renamed."""
    root = [copy.deepcopy(tree)]
    for edit in edits:
        rng = random.Random(edit)
        parent: Any = root
        key: Any = 0
        while isinstance(parent[key], (dict, list)) and parent[key] and rng.random() < 0.85:
            parent = parent[key]
            key = rng.choice(list(parent)) if isinstance(parent, dict) else rng.randrange(len(parent))
        kind = rng.randrange(6)
        if kind <= 2 or parent is root:
            parent[key] = copy.deepcopy(rng.choice(nasty))
        elif kind == 3:
            del parent[key]
        elif kind == 4 and isinstance(parent, list):
            parent[key:key] = copy.deepcopy(parent[key : key + 2]) * rng.choice((1, 1, 5))
        elif isinstance(parent, dict):
            parent[rng.choice(("x", "", *map(str, parent)))] = parent.pop(key)
        elif isinstance(parent[key], (int, float)) and abs(parent[key]) < 1e300:
            parent[key] = parent[key] * rng.choice((-1, 0, 10, 1e-6, 1e6, 1e300))
    return root[0]


def near(seeds: Sequence[Any], edited: Callable[..., Any]) -> st.SearchStrategy[Any]:
    """Returns a strategy of edited seeds."""
    return st.builds(lambda i, edits: edited(seeds[i], edits), st.integers(0, len(seeds) - 1), EDITS)


def near_bytes(*seeds: bytes) -> st.SearchStrategy[bytes]:
    """Returns a strategy of bytes near the seeds; some are any bytes at all."""
    return st.one_of(near(seeds, edited_bytes), near(seeds, edited_bytes), st.binary(max_size=300))


def near_trees(*seeds: Any) -> st.SearchStrategy[Any]:
    """Returns a strategy of trees near the seeds."""
    return near(seeds, edited_tree)


def near_json(*seeds: Any) -> st.SearchStrategy[str]:
    """Returns a strategy of JSON texts near the seeds: mostly whole ones with edited values, and torn ones."""
    whole = near_trees(*seeds).map(json.dumps)
    torn = near([json.dumps(seed).encode() for seed in seeds], edited_bytes).map(lambda data: data.decode("latin-1"))
    return st.one_of(whole, whole, torn)
