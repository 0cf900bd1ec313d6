"""A picture of a stored and a new trace."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from golden.chain import CYCLE_S
from golden.stored import BLOCK, NAMES, TOLERANCE, Stored, differing

ROWS = (
    ("tools", slice(0, 3), "tool position [m]"),
    ("tools", slice(3, 9), "two axes of the tool"),
    ("hands", slice(0, 4), "robot hand [rad]"),
    ("goals", slice(0, 7), "goals of the joints [rad]"),
)


def draw(name: str, old: Stored, new: Stored, path: Path, tolerance: dict[str, float] = TOLERANCE) -> None:
    """Draws both, and beside them what is new less what was stored, in a scale of its own. What differs has a red
    background.
    """
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, plots = pyplot.subplots(len(ROWS), 2, figsize=(18, 12), constrained_layout=True, sharex="row")
    for (both, apart), (kind, columns, label) in zip(plots, ROWS):
        pace = BLOCK[kind] * CYCLE_S if kind == "goals" else float(BLOCK[kind])
        a, b = old.means[kind][:, columns], new.means[kind][:, columns]
        n = min(len(a), len(b))
        for i, part in enumerate(NAMES[kind][columns]):
            both.plot(pace * np.arange(len(a)), a[:, i], "-", color=f"C{i}", linewidth=2.5, label=part)
            both.plot(pace * np.arange(len(b)), b[:, i], "--", color="black", linewidth=1.0)
            apart.plot(pace * np.arange(n), b[:n, i] - a[:n, i], color=f"C{i}")
        for block in differing(kind, old, new, tolerance):
            for plot in (both, apart):
                plot.axvspan((block - 0.5) * pace, (block + 0.5) * pace, color="red", alpha=0.15, linewidth=0)
        both.set_ylabel(label)
        both.legend(fontsize="x-small", ncol=3)
        apart.set_ylabel("new less stored")
        for plot in (both, apart):
            plot.set_xlabel("time [s]" if kind == "goals" else "frame")
    figure.suptitle(f"{name}: stored (colours) and new (black, dashed); red where they differ")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=70)
    pyplot.close(figure)
