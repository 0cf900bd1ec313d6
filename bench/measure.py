"""Rows of the table, how they are measured, and the table's text."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common.errors import RigError

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = ROOT.parent / "shared" / "data"
SRC = ROOT / "src"
HEAD = ("measure", "median", "p99", "unit", "goal", "peer", "ratio")
WHAT_WIDTH = 38  # so that no line of the table is wider than 100 columns


@dataclass(frozen=True)
class Goal:
    """What a measure should be on two free cores: `median` and `p99` at most, or `median` at least."""

    median: float | None
    p99: float | None = None
    at_least: bool = False

    def __str__(self) -> str:
        sign = ">=" if self.at_least else "<="
        return f"{sign} " + "/".join(
            "-" if x is None else f"{x:g}" for x in (self.median, self.p99)[: 1 + bool(self.p99)]
        )


@dataclass(frozen=True)
class Peer:
    """What a measure is compared with: a program or way in general use, measured in the same run; its median."""

    name: str
    median: float


@dataclass(frozen=True)
class Row:
    """One row of the table.

    Attributes:
        what: was measured.
        median: of the samples, or the only number there is; None where nothing could be measured.
        p99: 99th percentile of the samples; None where there is only one number.
        unit: of both.
        how: samples and settings, or why there is no number.
        goal: what it should be.
        peer: what it is compared with."""

    what: str
    median: float | None
    p99: float | None
    unit: str
    how: str
    goal: Goal | None = None
    peer: Peer | None = None

    @property
    def ratio(self) -> float | None:
        """The median as a multiple of the peer's."""
        if self.median is None or self.peer is None or not self.peer.median:
            return None
        return self.median / self.peer.median


def row(
    what: str, samples: Iterable[float], unit: str, how: str, goal: Goal | None = None, peer: Peer | None = None
) -> Row:
    """Returns the row of samples that are in `unit` already."""
    samples = np.asarray(samples, dtype=float)
    median, p99 = np.percentile(samples, (50, 99)).tolist()
    return Row(what, median, p99, unit, f"{len(samples)} x: {how}", goal, peer)


def number(what: str, value: float, unit: str, how: str, goal: Goal | None = None, peer: Peer | None = None) -> Row:
    """Returns the row of a single number."""
    return Row(what, float(value), None, unit, how, goal, peer)


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


def cells(row: Row) -> tuple[str, ...]:
    """Returns a row's cells under HEAD."""
    peer = "" if row.peer is None else f"{row.peer.name} {text(row.peer.median)}"
    ratio = "" if row.ratio is None else f"{row.ratio:.2g}" if row.ratio < 10.0 else f"{row.ratio:.0f}"
    goal = "" if row.goal is None else str(row.goal)
    return row.what, text(row.median), text(row.p99), row.unit, goal, peer, ratio


def aligned(lines: Sequence[Sequence[str]], right: Iterable[int]) -> list[str]:
    """Returns lines of cells in columns; the columns `right` are aligned at the right."""
    widths = [max(map(len, column)) for column in zip(*lines)]
    right = set(right)
    return [
        "  ".join(
            cell.rjust(w) if i in right else cell.ljust(w) for i, (cell, w) in enumerate(zip(line, widths))
        ).rstrip()
        for line in lines
    ]


class BenchError(RigError):
    """A benchmark could not be run."""
