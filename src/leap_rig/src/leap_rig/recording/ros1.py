"""Decodes messages of ROS 1 by the definition stored with them, which is read as data: no code is made from it."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from typing import Any, Callable

import numpy as np

from common.errors import RigError

NUMBERS = {
    "bool": "?", "byte": "i1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2",
    "int32": "<i4", "uint32": "<u4", "int64": "<i8", "uint64": "<u8", "float32": "<f4", "float64": "<f8",
}  # fmt: skip
LONG = {"int64": "q", "uint64": "Q"}  # numpy calls them l and L, which struct takes for 4 bytes
SECONDS = {"time": np.dtype("<u4,<u4"), "duration": np.dtype("<i4,<i4")}
LENGTH = struct.Struct("<I")
FIELD = re.compile(r"([\w/]+)(?:\[(\d*)\])?\s+([A-Za-z]\w*)\s*(=?)")

Reader = Callable[[bytes, int], "tuple[Any, int]"]
"""Returns the value that begins at a byte, and where it ends."""


class MessageFault(RigError):
    """A definition or a message cannot be read."""


def decoder(kind: str, definition: str) -> Callable[[bytes], dict[str, Any]]:
    """Returns what decodes messages of the type `kind`, such as std_msgs/Bool, with its full definition. A message is a
    dict by field; times and durations are nanoseconds, arrays of numbers and of times numpy arrays, uint8[] is bytes.
    Raises MessageFault, as does what it returns."""
    texts = {kind: ""}
    for part in re.split(r"^=+\n", definition, flags=re.MULTILINE):
        named = re.match(r"MSG: (\S+)\n", part)
        texts[named.group(1) if named else kind] = part[named.end() if named else 0 :]
    read = _message(kind, texts, 0, {})

    def decode(data: bytes) -> dict[str, Any]:
        try:
            value, end = read(data, 0)
        except (struct.error, ValueError, IndexError) as error:
            raise MessageFault(f"A message {kind} of {len(data)} bytes cannot be read: {error}.") from error
        if end != len(data):
            raise MessageFault(f"A message {kind} has {len(data)} bytes, but its definition {end}.")
        return value

    return decode


def _message(kind: str, texts: Mapping[str, str], depth: int, known: dict[str, Reader]) -> Reader:
    """Returns the reader of a message; `known` holds those that were made before, each only once."""
    deepest = 20  # messages within messages
    if kind in known:
        return known[kind]
    if depth > deepest or kind not in texts:
        raise MessageFault(f"The definition of {kind} is missing or contains itself.")
    fields: list[tuple[str, Reader]] = []
    for line in texts[kind].splitlines():
        found = FIELD.match(line.partition("#")[0].strip())
        if not found or found.group(4):  # empty, or a constant
            continue
        name, length, field, _ = found.groups()
        if name not in NUMBERS and name not in SECONDS and name != "string" and "/" not in name:
            name = "std_msgs/Header" if name == "Header" else f"{kind.partition('/')[0]}/{name}"
        fields.append((field, _field(name, length, texts, depth, known)))

    def read(data: bytes, at: int) -> tuple[dict[str, Any], int]:
        values = {}
        for field, read_field in fields:
            values[field], at = read_field(data, at)
        return values, at

    known[kind] = read
    return read


def _field(name: str, length: str | None, texts: Mapping[str, str], depth: int, known: dict[str, Reader]) -> Reader:
    """Returns the reader of a field; `length`: None for a single value, empty for an array of any length."""
    if length is not None and (name in NUMBERS or name in SECONDS):
        return _array(name, length)
    if name in NUMBERS:
        return _number(LONG.get(name) or np.dtype(NUMBERS[name]).char)
    if name in SECONDS:
        return _time("<II" if name == "time" else "<ii")
    one = _string if name == "string" else _message(name, texts, depth + 1, known)
    if length is None:
        return one

    def read(data: bytes, at: int) -> tuple[list[Any], int]:
        count, at = _count(data, at, length)
        values = []
        for _ in range(count):
            value, end = one(data, at)
            if end == at:
                raise ValueError(f"an array of {count} messages {name} without content")
            values.append(value)
            at = end
        return values, at

    return read


def _count(data: bytes, at: int, length: str) -> tuple[int, int]:
    """Returns the number of elements of an array, and where they begin."""
    count = int(length) if length else LENGTH.unpack_from(data, at)[0]
    if count > len(data):
        raise ValueError(f"an array claims {count} elements")
    return count, at if length else at + LENGTH.size


def _array(name: str, length: str) -> Reader:
    dtype = SECONDS[name] if name in SECONDS else np.dtype(NUMBERS[name])

    def read(data: bytes, at: int) -> tuple[Any, int]:
        count, at = _count(data, at, length)
        end = at + count * dtype.itemsize
        if end > len(data):
            raise ValueError(f"an array of {count} elements is cut off")
        if name in ("uint8", "char"):
            return data[at:end], end
        values = np.frombuffer(data, dtype, count, at)
        if name in SECONDS:
            values = values["f0"].astype(np.int64) * 10**9 + values["f1"]
        return values, end

    return read


def _number(code: str) -> Reader:
    packed = struct.Struct(f"<{code}")

    def read(data: bytes, at: int) -> tuple[Any, int]:
        return packed.unpack_from(data, at)[0], at + packed.size

    return read


def _time(code: str) -> Reader:
    packed = struct.Struct(code)

    def read(data: bytes, at: int) -> tuple[int, int]:
        seconds, nanoseconds = packed.unpack_from(data, at)
        return 10**9 * seconds + nanoseconds, at + packed.size

    return read


def _string(data: bytes, at: int) -> tuple[str, int]:
    (count,), at = LENGTH.unpack_from(data, at), at + LENGTH.size
    if at + count > len(data):
        raise ValueError(f"a string of {count} bytes is cut off")
    return data[at : at + count].decode("utf-8", "surrogateescape"), at + count
