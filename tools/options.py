"""Values of the command line that are checked before any work begins, as types for argparse."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path


def number(least: float, most: float, kind: Callable[[str], float] = float) -> Callable[[str], float]:
    """Returns the type of a number from `least` to `most`; `kind` is float or int."""

    def read(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= most:  # nor NaN
            raise argparse.ArgumentTypeError(f"{text!r} is not a number from {least:g} to {most:g}")
        return value

    return read


def new_file(text: str) -> Path:
    """The type of a file that is written at the end: it can be written; what it holds stays until then."""
    path = Path(text)
    was_there = os.path.lexists(path)
    try:
        path.open("ab").close()
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be written: {error.strerror}") from error
    if not was_there:
        path.unlink()
    return path


def new_folder(text: str) -> Path:
    """The type of a folder for files, which is made."""
    path = Path(text)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be made: {error.strerror}") from error
    if not os.access(path, os.W_OK):
        raise argparse.ArgumentTypeError(f"{text!r} takes no files")
    return path


def is_written(path: Path, text: str) -> bool:
    """Writes results of a long run at its end; where that fails says so and returns False, and no more is lost."""
    try:
        path.write_text(text)
    except OSError as error:
        print(f"The results could not be written to {path}: {error.strerror}.", file=sys.stderr)
        return False
    return True
