"""Command lines of the simulated devices: checked values, signals, and errors of one sentence with exit code 1."""

from __future__ import annotations

import argparse
import math
import signal
import sys
from collections.abc import Callable
from typing import NoReturn


class CommandLine(argparse.ArgumentParser):
    """The options of a simulated device; an invalid one ends the program with one sentence and exit code 1."""

    def __init__(self, name: str, description: str) -> None:
        super().__init__(prog=f"{name}.py", description=description)
        self._name = name

    def error(self, message: str) -> NoReturn:
        """Ends the program."""
        self.exit(1, f"{self._name}: {message}\n")


def port(text: str) -> int:
    """A port, 0 for any free one."""
    value = int(text) if text.isdecimal() else -1
    if not 0 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not a port between 0 and 65535")
    return value


def _number(valid: Callable[[float], bool], meaning: str) -> Callable[[str], float]:
    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and valid(value)):
            raise argparse.ArgumentTypeError(f"{text!r} is not {meaning}")
        return value

    return convert


finite = _number(lambda value: True, "a finite number")
not_negative = _number(lambda value: value >= 0.0, "a number from 0 up")
positive = _number(lambda value: value > 0.0, "a number above 0")
angle = _number(lambda value: -180.0 <= value <= 180.0, "an angle between -180 and 180")


def parse_options(parser: argparse.ArgumentParser, arguments: list[str] | None) -> argparse.Namespace:
    """Returns the options; ignores the name:=value pairs that roslaunch adds to the arguments of every node."""
    options, others = parser.parse_known_args(arguments)
    unknown = [other for other in others if ":=" not in other]
    if unknown:
        parser.error(f"unknown arguments: {' '.join(unknown)}")
    return options


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Calls `stop` at Ctrl-C and at SIGTERM."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop())


def failed(name: str, error: Exception) -> int:
    """Reports the error that ends a program; returns its exit code."""
    print(f"{name}: {error}", file=sys.stderr)
    return 1
