"""The program `evaluate_tag_pose.py`: compares the three poses of the marker board with the truth in simulated images.

It needs no ROS master. The images come from `rosrun rig_simulation panel_pictures.py`, or from a folder with the same
content. The evaluation is repeated with wrong descriptions of the cameras.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import cv2
import matplotlib
import numpy as np

from apriltag_ros.settings import detector_settings
from common.command_line import exit_code, real, whole
from common.config import parse
from vision.marker_board import pose_evaluation as tables
from vision.marker_board.plane_fit import PlanePoseConfig
from vision.marker_board.plane_pose import RgbdDetector
from vision.marker_board.pose_evaluation import METHODS, PoseTrial, cells, trial, values
from vision.ros.marker_board import image_folder
from vision.ros.marker_board.image_folder import BoardImageSet, read_config

NAME = "evaluate_tag_pose"
COLOURS = {"colour": "tab:red", "plane": "tab:blue", "fused": "tab:green"}
QUANTITIES = {"position": "centre [mm]", "rotation": "rotation [deg]", "reach": f"{tables.REACH_M:g} m away [mm]"}
OFFSET = {"colour": -0.03, "plane": 0.0, "fused": 0.03}


def main(arguments: list[str] | None = None) -> int:
    """Evaluates; returns the exit code."""
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("tag_pose"), help="folder for tables and plots")
    parser.add_argument("--panel", choices=image_folder.TAGS, default="bundle", help="the marker board in the images")
    parser.add_argument("--pictures", type=Path, help="folder with images; omitted: the simulation renders them")
    parser.add_argument("--units", type=whole(1, 100), default=5, help="number of sensors, each with its own errors")
    parser.add_argument("--seed", type=int, default=0, help="seed of poses, sensors and noise")
    parser.add_argument("--focal-error", type=real(-0.2, 0.2), default=0.01, help="relative error of the focal length")
    parser.add_argument("--depth-bias", type=real(-0.2, 0.2), default=0.01, help="added to every depth [m]")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)

    def evaluate() -> None:
        options.output.mkdir(parents=True, exist_ok=True)
        if options.pictures is not None:
            _evaluate(options, options.pictures)
            return
        more = ("--units", str(options.units), "--seed", str(options.seed))
        with image_folder.rendered_images(options.panel, *more) as folder:
            _evaluate(options, folder)

    return exit_code(NAME, evaluate)


def _evaluate(options: argparse.Namespace, folder: Path) -> None:
    images = image_folder.read_images(folder)
    config = parse(PlanePoseConfig, read_config("plane_pose.yaml"), prefix="plane_pose/")
    focal, bias = options.focal_error, options.depth_bias
    informed = dataclasses.replace(config, focal_sd=abs(focal))
    variants = {
        "as calibrated": (config, 0.0, 0.0),
        f"focal length {focal:+.1%}": (config, focal, 0.0),
        f"focal length {focal:+.1%} with focal_sd {abs(focal):g}": (informed, focal, 0.0),
        f"depth {1e3 * bias:+.0f} mm": (config, 0.0, bias),
    }
    results = {name: _trials(images, options.panel, *variant) for name, variant in variants.items()}
    sections = [line for name, trials in results.items() for line in (f"## {name}", "", *tables.markdown(trials), "")]
    head = [f"# Pose of the marker board ({options.panel}) against the truth: median / 95 %", ""]
    lines = [tables.CSV_HEAD, *(line for name, trials in results.items() for line in tables.csv(name, trials))]
    (options.output / "tag_pose.md").write_text("\n".join([*head, *sections]), encoding="utf-8")
    (options.output / "tag_pose.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    _draw(results, options.output)
    for name, trials in results.items():
        for method in METHODS:
            parts = [np.median(values(trials, method, q)) for q in ("position", "rotation", "reach")]
            found = values(trials, method, "position").size
            errors = f"{parts[0]:.1f} mm, {parts[1]:.2f} deg, {parts[2]:.1f} mm half a metre away"
            print(f"{name}, {method}: {errors}, in {found} of {len(trials)} images")
    print(f"{NAME}: tables and plots are in {options.output}")


def _trials(
    images: BoardImageSet, board: str, config: PlanePoseConfig, focal_error: float, depth_bias: float
) -> list[PoseTrial]:
    """Returns the errors in all images, with a relative error of the focal length, and a bias of all depths [m]."""
    settings = detector_settings({**read_config("settings.yaml"), "rectified": False})
    rgb = tables.wrong_lens(images.rgb, focal_error)
    detector = RgbdDetector(settings, image_folder.board_target(board), images.plate, config)
    trials = []
    for moment, pair in enumerate(images.pairs()):  # a second apart: no orientation is known from the image before
        depth = pair.depth + np.float32(depth_bias)
        found = detector.detect(pair.grey, rgb, depth, images.depth, images.T_rgb_depth, float(moment))
        trials.append(trial(pair.distance, pair.tilt, pair.T_rgb_board, None if found is None else found.depth))
    return trials


def _draw(results: dict[str, list[PoseTrial]], folder: Path) -> None:
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
