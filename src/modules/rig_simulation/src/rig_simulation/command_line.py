"""Values on the command lines of the simulated devices; a bad one is a sentence that names it."""

from __future__ import annotations

import argparse
import math


def port(text: str) -> int:
    """A port, 0 for any free one."""
    value = int(text) if text.isdecimal() else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port between 0 and 65535")
    return value


def finite(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def not_negative(text: str) -> float:
    """A finite number from 0 up."""
    value = finite(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 up")
    return value


def positive(text: str) -> float:
    """A finite number above 0."""
    value = finite(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0")
    return value


def angle(text: str) -> float:
    """An angle between -180 and 180 degrees."""
    value = finite(text)
    if not -180.0 <= value <= 180.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not an angle between -180 and 180")
    return value


def parse_options(parser: argparse.ArgumentParser, arguments: list[str] | None) -> argparse.Namespace:
    """Returns the options; the name:=value pairs that roslaunch adds to the arguments of every node are passed over."""
    options, others = parser.parse_known_args(arguments)
    unknown = [other for other in others if ":=" not in other]
    if unknown:
        parser.error(f"unknown arguments: {' '.join(unknown)}")
    return options
