"""How near a refinement network comes to an operator, by the number of episodes that it learned from, as an image."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Mapping, Sequence

import numpy as np

from common.statistics import median, proportion

COLOURS = ("tab:gray", "tab:orange", "tab:green")


def draw(
    path: Path,
    learned: Mapping[int, Sequence[float]],
    others: Mapping[str, Sequence[float]],
    near_mm: float,
) -> None:
    """Draws the median error, and the fraction of errors below a distance, each with its 95 % interval.

    Args:
        learned: errors of the refinement network [mm] by the number of episodes.
        others: errors of other methods [mm] by their names; lines.
        near_mm: the distance [mm].
    """
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)

    def middle(errors: Sequence[float]) -> tuple[float, float, float]:
        found = median(errors)
        return found.value, found.low, found.high

    def near(errors: Sequence[float]) -> tuple[float, float, float]:
        found = proportion(np.asarray(errors) < near_mm)
        return 100.0 * found.value, 100.0 * found.low, 100.0 * found.high

    _curve(left, learned, others, middle)
    _curve(right, learned, others, near)
    left.set(ylabel="position error [mm], median", ylim=(0, None))
    right.set(ylabel=f"within {near_mm:.0f} mm [%]", ylim=(0, 100))
    left.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def _curve(
    axes: Any,
    learned: Mapping[int, Sequence[float]],
    others: Mapping[str, Sequence[float]],
    summary: Callable[[Sequence[float]], tuple[float, float, float]],
) -> None:
    counts = sorted(learned)
    value, low, high = np.transpose([summary(learned[n]) for n in counts])
    axes.errorbar(counts, value, [value - low, high - value], marker="o", capsize=3, label="with refinement network")
    for (name, errors), colour in zip(others.items(), COLOURS):
        value, low, high = summary(errors)
        axes.axhline(value, color=colour, linestyle="--", label=name)
        axes.axhspan(low, high, color=colour, alpha=0.12)
    axes.set(xlabel="episodes learned from", xscale="log", xticks=counts, xticklabels=map(str, counts))
    axes.minorticks_off()
