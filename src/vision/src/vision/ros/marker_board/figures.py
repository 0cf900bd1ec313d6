"""Plots of the pose errors over distance, one file for each variant of the camera descriptions."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from vision.marker_board.pose_evaluation import METHODS, REACH_M, PoseTrial, cells, values

COLOURS = {"colour": "tab:red", "plane": "tab:blue", "fused": "tab:green"}
QUANTITIES = {
    "position": "centre [mm]",
    "rotation": "rotation [deg]",
    "reach": f"{REACH_M:g} m away [mm]",
}
OFFSET = {"colour": -0.03, "plane": 0.0, "fused": 0.03}


def draw(results: dict[str, list[PoseTrial]], folder: Path) -> None:
    """Writes tag_pose_<n>.png for each variant: rows are quantities, columns tilts; median and 5 to 95 % range."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    for number, (name, trials) in enumerate(results.items(), start=1):
        tilts = sorted({tilt for _, tilt in cells(trials)})
        distances = sorted({distance for distance, _ in cells(trials)})
        figure, axes = pyplot.subplots(
            len(QUANTITIES), len(tilts), figsize=(2.6 * len(tilts) + 1.0, 7.0), sharex=True, sharey="row", squeeze=False
        )
        for column, tilt in enumerate(tilts):
            for row, (quantity, label) in enumerate(QUANTITIES.items()):
                axis = axes[row, column]
                for method in METHODS:
                    found = [values(trials, method, quantity, d, tilt) for d in distances]
                    bands = [(d, np.percentile(f, [5, 50, 95])) for d, f in zip(distances, found) if f.size]
                    if not bands:
                        continue
                    x = np.array([d for d, _ in bands]) + OFFSET[method]
                    low, middle, high = np.array([p for _, p in bands]).T
                    error = (middle - low, high - middle)
                    axis.errorbar(x, middle, error, fmt="o-", color=COLOURS[method], label=method, ms=3, capsize=2)
                axis.set_yscale("log")
                axis.grid(True, which="both", alpha=0.25)
                if column == 0:
                    axis.set_ylabel(label)
            axes[0, column].set_title(f"tilt {tilt:g} deg")
            axes[-1, column].set_xlabel("distance [m]")
        axes[0, -1].legend(fontsize=8)
        figure.suptitle(f"Error of the marker board pose, {name}")
        figure.tight_layout()
        figure.savefig(folder / f"tag_pose_{number}.png", dpi=90)
        pyplot.close(figure)
