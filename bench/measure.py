"""Rows of the table, and how they are measured."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import RigError

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = ROOT.parent / "shared" / "data"
SRC = ROOT / "src"


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        what: was measured.
        median: of the samples, or the only number there is; None where nothing could be measured.
        p99: 99th percentile of the samples; None where there is only one number.
        unit: of both.
        how: samples and settings, or why there is no number.
    """

    what: str
    median: float | None
    p99: float | None
    unit: str
    how: str


def row(what: str, samples: Iterable[float], unit: str, how: str) -> Row:
    """Returns the row of samples that are in `unit` already."""
    samples = np.asarray(samples, dtype=float)
    median, p99 = np.percentile(samples, (50, 99)).tolist()
    return Row(what, median, p99, unit, f"{len(samples)} x: {how}")


def number(what: str, value: float, unit: str, how: str) -> Row:
    """Returns the row of a single number."""
    return Row(what, float(value), None, unit, how)


def timed(call: Callable, arguments: Iterable[tuple]) -> tuple[np.ndarray, list]:
    """Calls `call` with each of the arguments; returns the time that each call took [us], and the results."""
    times, results = [], []
    for args in arguments:
        begin = time.perf_counter_ns()
        result = call(*args)
        times.append(time.perf_counter_ns() - begin)
        results.append(result)
    return np.array(times) * 1e-3, results


def text(value: float | None) -> str:
    """Returns a number with three digits or more, `-` for None."""
    if value is None:
        return "-"
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{min(max(digits, 0), 4)}f}"


class BenchError(RigError):
    """A benchmark could not be run."""
