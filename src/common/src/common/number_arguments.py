"""Numbers with a range as types of argparse."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def real(low: float, high: float, open_low: bool = False) -> Callable[[str], float]:
    """Returns a type for numbers in [low, high], or in (low, high] if `open_low`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high or (open_low and value == low):
            interval = f"{'(' if open_low else '['}{low:g}, {high:g}]"
            raise argparse.ArgumentTypeError(f"{text!r} is not a number in {interval}")
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Returns a type for whole numbers from low to high; low is not negative."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
        return int(text)

    return read
