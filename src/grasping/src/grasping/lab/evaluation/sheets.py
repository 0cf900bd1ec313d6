"""Pictures of an evaluation: the grasps that failed, and whether a quality means what it says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Mapping, NamedTuple, Sequence

import numpy as np

from common.statistics import proportion
from grasping.network.maps import Peak

COLUMNS = 6
MOST = 36  # grasps of a sheet
GROUPS = 6  # ranges of the quality, with equally many grasps


class FailedGrasp(NamedTuple):
    """A grasp that lifted nothing, or not what it was meant for."""

    scene: int
    reason: str  # of `common.lift_trial`
    heights: np.ndarray  # above the table, of the network's image, shape (h, w) [m]
    peak: Peak | None  # in that image, None where there was no grasp
    opening: float  # [m]
    tilt: float = 0.0  # of the approach from straight down [rad]


def failure_sheet(path: Path, method: str, tried: int, reasons: Sequence[str], shown: Sequence[FailedGrasp]) -> None:
    """Draws the failed grasps of a method; `tried`: number of all its grasps; `reasons`: of all failures."""
    side = 260  # middle part of the network's image that is shown [px]
    low_m = -0.01  # height that is shown black
    high_m = 0.11  # and white
    inch = 1.9  # side of a picture in the sheet
    import matplotlib.figure

    rows = max(1, -(-len(shown) // COLUMNS))
    figure = matplotlib.figure.Figure(figsize=(inch * COLUMNS, (inch + 0.45) * rows + 0.7), layout="constrained")
    counts = ", ".join(f"{count} {reason}" for reason, count in Counter(reasons).most_common())
    first = f"; the first {len(shown)} are shown" if len(shown) < len(reasons) else ""
    figure.suptitle(
        f"{method}: {len(reasons)} of {tried} grasps failed{first}\n{counts or 'no failure'}\n"
        "height above the table, black 0 to white 110 mm; the fingers close along the thin line; no error of the arm",
        fontsize=9,
    )
    for axes in figure.subplots(rows, COLUMNS, squeeze=False).flat:
        axes.axis("off")
    for axes, grasp in zip(figure.axes, shown):
        h, w = grasp.heights.shape
        left, top = 0.5 * (w - side) - 0.5, 0.5 * (h - side) - 0.5
        axes.imshow(grasp.heights, cmap="gray", vmin=low_m, vmax=high_m)
        axes.set(xlim=(left, left + side), ylim=(top + side, top))
        text = f"scene {grasp.scene}: {grasp.reason}"
        if grasp.peak is not None:
            for x, y, width in _lines(grasp.peak):
                axes.plot(x, y, color="tab:red", linewidth=width)
            text += f"\nquality {grasp.peak.quality:.2f}, open {1000.0 * grasp.opening:.0f} mm"
            text += f", {np.degrees(grasp.tilt):.0f} deg" if grasp.tilt else ""
        axes.set_title(text, fontsize=7)
    figure.savefig(path, dpi=100)


def _lines(peak: Peak) -> list[tuple[list[float], list[float], float]]:
    """Returns x, y and width of the lines of a grasp: from finger to finger, and both fingers."""
    jaw_px = 9.0  # half a finger's line across the closing direction
    middle = np.array([peak.column, peak.row], dtype=float)
    along = np.array([np.cos(peak.angle), -np.sin(peak.angle)])
    across = np.array([-along[1], along[0]])
    ends = [middle + side * 0.5 * peak.width * along for side in (-1.0, 1.0)]
    lines = [(ends[0], ends[1], 0.8), *((end - jaw_px * across, end + jaw_px * across, 2.5) for end in ends)]
    return [([p[0], q[0]], [p[1], q[1]], width) for p, q, width in lines]


def reliability_plot(path: Path, found: Mapping[str, tuple[Sequence[float], Sequence[bool]]]) -> None:
    """Draws the fraction lifted by the quality, with 95 % intervals and counts; `found`: qualities and whether lifted,
    by method. The ranges of the quality hold equally many grasps.
    """
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(6.5, 5.0), layout="constrained")
    axes = figure.subplots()
    axes.plot([0.0, 100.0], [0.0, 100.0], color="tab:gray", linestyle=":", label="quality = probability")
    for number, (name, (quality, lifted)) in enumerate(found.items()):
        order = np.argsort(quality, kind="stable")
        groups = [part for part in np.array_split(order, GROUPS) if len(part)]
        x = [100.0 * float(np.mean(np.asarray(quality)[part])) for part in groups]
        of = [proportion(np.asarray(lifted)[part]) for part in groups]
        y = [100.0 * p.value for p in of]
        error = [[v - 100.0 * p.low for v, p in zip(y, of)], [100.0 * p.high - v for v, p in zip(y, of)]]
        axes.errorbar(x, y, error, marker="o", capsize=3, color=f"C{number % 10}", label=f"{name}, n = {len(order)}")
        for at, value, p in zip(x, y, of):
            axes.annotate(str(p.trials), (at, value), xytext=(4, -11), textcoords="offset points", fontsize=7)
    axes.set(xlim=(0.0, 102.0), ylim=(0.0, 104.0), xlabel="quality of the grasp, mean of the range [%]")
    axes.set(ylabel="lifted [%]", title="numbers: grasps of the range; bars: 95 % intervals")
    axes.legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=110)
