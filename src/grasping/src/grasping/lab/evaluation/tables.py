"""Tables of lifted grasps in Markdown, with 95 % intervals and the numbers of grasps.

A row is a grasp: the columns of results.csv. Methods named `NAME #1`, `NAME #2`, .. are several
trainings of one; the tables give their mean over the trainings as well, in intervals over the scenes.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Mapping

import numpy as np

from common.lift_trial import FAILURES
from common.statistics import Estimate, paired_difference, proportion

TRAINING = re.compile(r"(.+) #\d+")
Row = Mapping[str, Any]
PARTS: dict[str, Callable[[Row], bool]] = {
    "one object": lambda row: row["objects"] == 1,
    "clutter": lambda row: row["objects"] > 1,
}


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = (header, ["---"] * len(header), *rows)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def trainings(methods: Iterable[str]) -> dict[str, list[str]]:
    """Returns the methods that are several trainings of one, by that one's name and number of trainings."""
    found = defaultdict(list)
    for method in methods:
        if name := TRAINING.fullmatch(method):
            found[name[1]].append(method)
    return {f"{name}, mean of {len(of)}": of for name, of in found.items() if len(of) > 1}


def table(rows: Sequence[Row], methods: Iterable[str]) -> str:
    """Returns how many grasps were lifted, and how many were right by the rectangle metric."""
    methods = list(methods)
    fields = ("lifted", "rectangle")
    header = ("method", *(f"{name}: {field} %" for field in fields for name in PARTS))
    lines = [[m, *(fraction(rows, m, field, part) for field in fields for part in PARTS.values())] for m in methods]
    for name, members in trainings(methods).items():
        cells = []
        for field in fields:
            for part in PARTS.values():
                values = list(_by_scene(rows, members, field, part).values())
                mean = paired_difference(values, np.zeros(len(values))) if values else None
                cells.append(f"{_clipped(mean):.0f}, n = {len(values)} x {len(members)}" if mean else "-")
        lines.append([name, *cells])
    return markdown_table(header, lines)


def differences(rows: Sequence[Row], methods: Sequence[str], networks: Iterable[str]) -> str:
    """Returns how many points more each network lifts than each method before it, on the scenes that both tried."""
    networks, groups = set(networks), trainings(methods)
    grouped = {member for members in groups.values() for member in members}
    members = {**{m: [m] for m in methods if m not in grouped}, **groups}
    compared = {name: of for name, of in members.items() if of[0] in networks}
    parts = {**PARTS, "all": lambda _: True}
    lines = []
    for one, own in compared.items():
        for other in list(members)[: list(members).index(one)]:
            cells = []
            for part in parts.values():
                a, b = (_by_scene(rows, of, "lifted", part) for of in (own, members[other]))
                both = sorted(a.keys() & b.keys())
                first, second = ([values[scene] for scene in both] for values in (a, b))
                cells.append(f"{paired_difference(first, second):+.1f}, n = {len(both)}" if both else "-")
            lines.append([f"{one} - {other}", *cells])
    return markdown_table(("difference of lifted, points", *parts), lines) if lines else ""


def failures(rows: Sequence[Row], methods: Iterable[str]) -> str:
    lines = []
    for method in methods:
        reasons = [row["reason"] for row in rows if row["method"] == method]
        counts = Counter(reasons)
        lines.append([method, *(str(counts[reason]) for reason in FAILURES), str(len(reasons))])
    return markdown_table(("failed grasps", *FAILURES, "of all"), lines)


def calibration(rows: Sequence[Row], methods: Iterable[str]) -> str:
    """Returns how many grasps were lifted by the quality that the method gave them."""
    quality_limits = (0.3, 0.4, 0.5, 0.6)
    ranges = list(zip((-np.inf, *quality_limits), (*quality_limits, np.inf)))
    names = [f"< {quality_limits[0]}", *(f"{a} to {b}" for a, b in ranges[1:-1]), f">= {quality_limits[-1]}"]
    parts = [(lambda r, low=low, high=high: low <= r["quality"] < high) for low, high in ranges]
    lines = [[method, *(fraction(rows, method, "lifted", part) for part in parts)] for method in methods]
    return markdown_table(("lifted %, quality", *names), lines)


def fraction(rows: Iterable[Row], method: str, field: str, chosen: Callable[[Row], bool]) -> str:
    """Returns the fraction of the chosen rows of a method in which a field is true."""
    outcomes = [r[field] for r in rows if r["method"] == method and chosen(r)]
    return str(proportion(outcomes)) if outcomes else "-"


def _by_scene(
    rows: Iterable[Row], members: Sequence[str], field: str, chosen: Callable[[Row], bool]
) -> dict[int, float]:
    """Returns the percentage of methods for which a field is true, by scene; scenes that all of them tried."""
    found = defaultdict(list)
    for row in rows:
        if row["method"] in members and chosen(row):
            found[row["scene"]].append(100.0 * row[field])
    return {scene: float(np.mean(values)) for scene, values in found.items() if len(values) == len(members)}


def _clipped(mean: Estimate) -> Estimate:
    return Estimate(*(min(100.0, max(0.0, value)) for value in mean))
