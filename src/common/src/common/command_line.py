"""Command lines: checked numbers, roslaunch's own arguments, signals, and errors of one sentence with exit code 1."""

from __future__ import annotations

import argparse
import math
import re
import signal
import sys
from collections.abc import Callable
from typing import NoReturn

from common.errors import RigError


class CommandLine(argparse.ArgumentParser):
    """The options of a simulated device; an invalid one ends the program with one sentence and exit code 1."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(prog=f"{name}.py", description=description)
        self._name = name

    def error(self, message: str) -> NoReturn:
        self.exit(1, f"{self._name}: {message}\n")


def number_type(valid: Callable[[float], bool], meaning: str) -> Callable[[str], float]:
    """Returns a type of argparse for numbers that are valid, never NaN; `meaning`: what they are, in words."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isnan(value) or not valid(value):
            raise argparse.ArgumentTypeError(f"{text!r} is not {meaning}")
        return value

    return read


finite = number_type(math.isfinite, "a finite number")
not_negative = number_type(lambda value: 0.0 <= value < math.inf, "a number from 0 up")
positive = number_type(lambda value: 0.0 < value < math.inf, "a number above 0")
angle = number_type(lambda value: -180.0 <= value <= 180.0, "an angle between -180 and 180")


def real(low: float, high: float, open_low: bool = False) -> Callable[[str], float]:
    """Returns a type for numbers in [low, high], or in (low, high] if `open_low`."""
    interval = f"{'(' if open_low else '['}{low:g}, {high:g}]"
    return number_type(lambda value: low < value <= high or (value == low and not open_low), f"a number in {interval}")


def whole(low: int, high: int) -> Callable[[str], int]:
    """Returns a type for whole numbers from low to high; low is not negative."""

    def read(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {low} to {high}")
        return int(text)

    return read


def port(text: str) -> int:
    """A port, 0 for any free one."""
    value = int(text) if text.isdecimal() else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port between 0 and 65535")
    return value


def parse_options(parser: argparse.ArgumentParser, arguments: list[str] | None) -> argparse.Namespace:
    """Returns the options; ignores the name:=value pairs that roslaunch adds to the arguments of every node."""
    given = sys.argv[1:] if arguments is None else arguments
    return parser.parse_args([each for each in given if not re.match(r"[A-Za-z_~/][\w~/]*:=", each)])


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Calls `stop` at Ctrl-C and at SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def failed(name: str, error: Exception) -> int:
    """Reports the error that ends a program; returns its exit code."""
    print(f"{name}: {error}", file=sys.stderr)
    return 1


def exit_code(name: str, job: Callable[[], int | None]) -> int:
    """Runs the job of a program without ROS; returns its exit code, 1 after a RigError or OSError, which it reports."""
    try:
        return job() or 0
    except (RigError, OSError) as error:
        return failed(name, error)
