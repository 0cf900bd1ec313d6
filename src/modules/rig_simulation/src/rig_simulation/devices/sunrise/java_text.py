"""Numbers and lines as the server's Java writes and reads them (Double.toString, Double.parseDouble, Scanner)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from decimal import Decimal
from typing import Protocol

import numpy as np

_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?[dDfF]?", re.ASCII)
_HEXADECIMAL = re.compile(r"[+-]?0[xX]([0-9a-fA-F]+\.?[0-9a-fA-F]*|\.[0-9a-fA-F]+)[pP][+-]?\d+[dDfF]?", re.ASCII)
_SPECIAL = re.compile(r"[+-]?(NaN|Infinity)")
MAX_LINE_BYTES = 65536
LONGEST_ROBOT_LINE = 1024
_LINE_END = re.compile(rb"\r\n|[\n\r]|\xc2\x85|\xe2\x80[\xa8\xa9]")
_BLANKS = "".join(map(chr, range(0x21)))


def text(value: float) -> str:
    """Returns the shortest text for the double `value`, such as 0.1, -0.0, 5.0E-5, 1.0E7, NaN."""
    value = float(value)
    if 1e-3 <= abs(value) < 1e7 or value == 0.0:
        return repr(value)  # Python's shortest text is the same in this range
    if math.isnan(value):
        return "NaN"
    sign = "-" if math.copysign(1.0, value) < 0.0 else ""
    if math.isinf(value):
        return f"{sign}Infinity"
    _, digit_tuple, exponent = Decimal(repr(abs(value))).as_tuple()
    assert isinstance(exponent, int)  # a letter would mean a value that is not finite
    digits = "".join(map(str, digit_tuple)).rstrip("0")
    point = len(digit_tuple) + exponent
    return f"{sign}{digits[0]}.{digits[1:] or '0'}E{point - 1}"


def vector(values: Iterable[float]) -> str:
    """Returns the server's text of several numbers: each followed by `_`."""
    listed = values.tolist() if isinstance(values, np.ndarray) else values
    return "".join([f"{text(v)}_" for v in listed])


def number(source: str) -> float:
    """Returns the double that the text denotes; raises ValueError where Java's parser does, such as for `nan`, `inf`,
    `1,5` and the empty text."""
    stripped = source.strip(_BLANKS)
    if _DECIMAL.fullmatch(stripped):
        return float(stripped.rstrip("dDfF"))
    if _SPECIAL.fullmatch(stripped):
        return float(stripped)
    if _HEXADECIMAL.fullmatch(stripped):
        try:
            return float.fromhex(stripped.rstrip("dDfF"))
        except OverflowError:
            return -math.inf if stripped.startswith("-") else math.inf
    raise ValueError(f"{source!r} is not a number")


class LineSplitter(Protocol):
    """Collects bytes."""

    def feed(self, data: bytes) -> list[str]:
        """Returns the lines that the new bytes complete."""


class JavaLineSplitter:
    """Collects bytes; lines end with LF, CR LF, a lone CR, NEL, LS or PS."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Returns the lines that the new bytes complete, but empty ones; raises ValueError if one is too long."""
        *lines, self._rest = _LINE_END.split(self._rest + data)
        if len(self._rest) > MAX_LINE_BYTES:
            raise ValueError(f"a line is longer than {MAX_LINE_BYTES} bytes")
        return [line.decode("utf-8", "replace") for line in lines if line]


class RobotLineSplitter:
    """The same for the robot application: lines end with LF or CR, and what is too long is dropped to its end."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Returns the lines that the new bytes complete, but empty and too long ones."""
        *lines, rest = re.split(rb"[\n\r]", self._rest + data)
        self._rest = rest[: LONGEST_ROBOT_LINE + 1]
        return [line.decode("latin-1") for line in lines if 0 < len(line) <= LONGEST_ROBOT_LINE]
