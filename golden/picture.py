"""A picture of a stored and a new trace."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from golden.chain import CYCLE_S
from golden.stored import BLOCK, Stored, differing

ROWS = (
    ("tools", slice(0, 3), "tool position [m]"),
    ("tools", slice(3, 9), "two axes of the tool"),
    ("hands", slice(0, 4), "robot hand [rad]"),
    ("goals", slice(0, 7), "goals of the joints [rad]"),
)


def draw(name: str, old: Stored, new: Stored, path: Path) -> None:
    """Draws both, and the angle between the orientations; what differs has a red background."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, plots = pyplot.subplots(len(ROWS) + 1, 1, figsize=(11, 14), constrained_layout=True)
    for plot, (kind, columns, label) in zip(plots, ROWS):
        pace = BLOCK[kind] * CYCLE_S if kind == "goals" else float(BLOCK[kind])
        for trace, style, width in ((old, "-", 2.5), (new, "--", 1.0)):
            values = trace.means[kind][:, columns]
            for i, column in enumerate(values.T):
                colour = f"C{i}" if trace is old else "black"
                plot.plot(pace * np.arange(len(column)), column, style, color=colour, linewidth=width)
        for block in differing(kind, old, new):
            plot.axvspan((block - 0.5) * pace, (block + 0.5) * pace, color="red", alpha=0.15, linewidth=0)
        plot.set_ylabel(label)
        plot.set_xlabel("time [s]" if kind == "goals" else "frame")
    n = min(len(old.means["tools"]), len(new.means["tools"]))
    angle = np.degrees([_angle(a, b) for a, b in zip(old.means["tools"][:n, 3:], new.means["tools"][:n, 3:])])
    plots[-1].plot(BLOCK["tools"] * np.arange(n), angle, color="red")
    plots[-1].set_ylabel("tool, old to new [deg]")
    plots[-1].set_xlabel("frame")
    figure.suptitle(f"{name}: stored (colours) and new (black, dashed); red where they differ")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=70)
    pyplot.close(figure)


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle between two orientations by their first two columns, shape (6,) each [rad]."""
    R, S = (np.column_stack([x[:3], x[3:], np.cross(x[:3], x[3:])]) for x in (a, b))
    return float(np.arccos(np.clip((np.trace(R.T @ S) - 1.0) / 2.0, -1.0, 1.0)))
