"""The program `evaluate_tag_pose.py`: the three poses of the panel against the truth, in pictures of the simulation.

It needs no ROS master. The pictures come from `rosrun rig_simulation panel_pictures.py`, or from a folder that this or
another source filled in the same way. The same pictures are then looked at with cameras that are wrongly described.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from apriltag_ros.settings import detector_settings
from common.config import parse
from common.errors import RigError
from common.poses import read_only
from vision.marker_board.plane_fit import PlanePoseConfig
from vision.marker_board.pose_evaluation import CSV_HEAD, METHODS, Trial, csv, markdown, trial, values
from vision.marker_board.rgbd_detector import DepthTagDetector
from vision.ros.marker_board.figures import draw
from vision.ros.marker_board.image_folder import TAGS, Pictures, panel_target, read_pictures, take_pictures
from vision.ros.marker_board.image_folder import config as config_yaml

NAME = "evaluate_tag_pose"


def main(arguments: list[str] | None = None) -> int:
    """Evaluates; returns the exit code."""
    options = _options(arguments)
    cv2.setNumThreads(1)
    try:
        options.output.mkdir(parents=True, exist_ok=True)
        if options.pictures is not None:
            return _evaluate(options, options.pictures)
        with tempfile.TemporaryDirectory(prefix=NAME) as folder:
            take_pictures(Path(folder), options.panel, "--units", str(options.units), "--seed", str(options.seed))
            return _evaluate(options, Path(folder))
    except (RigError, OSError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1


def _evaluate(options: argparse.Namespace, folder: Path) -> int:
    pictures = read_pictures(folder)
    config = parse(PlanePoseConfig, config_yaml("plane_pose.yaml"), prefix="plane_pose/")
    focal, bias = options.focal_error, options.depth_bias
    told = dataclasses.replace(config, focal_sd=abs(focal))
    variants = {
        "as calibrated": (config, 0.0, 0.0),
        f"focal length {focal:+.1%}": (config, focal, 0.0),
        f"focal length {focal:+.1%} with focal_sd {abs(focal):g}": (told, focal, 0.0),
        f"depth {1e3 * bias:+.0f} mm": (config, 0.0, bias),
    }
    results = {name: _trials(pictures, options.panel, *variant) for name, variant in variants.items()}
    tables = [line for name, trials in results.items() for line in (f"## {name}", "", *markdown(trials), "")]
    head = [f"# Pose of the panel ({options.panel}) against the truth: median / 95 %", ""]
    lines = [CSV_HEAD, *(line for name, trials in results.items() for line in csv(name, trials))]
    (options.output / "tag_pose.md").write_text("\n".join([*head, *tables]), encoding="utf-8")
    (options.output / "tag_pose.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    draw(results, options.output)
    for name, trials in results.items():
        for method in METHODS:
            parts = [np.median(values(trials, method, q)) for q in ("position", "rotation", "reach")]
            found = values(trials, method, "position").size
            print(
                f"{name}, {method}: {parts[0]:.1f} mm, {parts[1]:.2f} deg, {parts[2]:.1f} mm half a metre away, in "
                f"{found} of {len(trials)} pictures"
            )
    print(f"{NAME}: tables and pictures are in {options.output}")
    return 0


def _trials(
    pictures: Pictures, panel: str, config: PlanePoseConfig, focal_error: float, depth_bias: float
) -> list[Trial]:
    """Returns the errors in all pictures, with a colour camera whose focal length is told wrongly, and depth that is
    farther by so much [m]."""
    settings = detector_settings({**config_yaml("settings.yaml"), "rectified": False})
    K = pictures.rgb.K.copy()
    K[[0, 1], [0, 1]] *= 1.0 + focal_error
    rgb = dataclasses.replace(pictures.rgb, K=read_only(K))
    found = []
    detector = DepthTagDetector(settings, panel_target(panel), pictures.plate, config)
    for moment, pair in enumerate(pictures.pairs()):  # a second apart: no pose is known from the picture before
        depth = pair.depth + np.float32(depth_bias)
        seen = detector.detect(pair.grey, rgb, depth, pictures.depth, pictures.T_rgb_depth, float(moment))
        found.append(trial(pair.distance, pair.tilt, pair.T_rgb_panel, None if seen is None else seen.depth))
    return found


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= 0.2:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number between -0.2 and 0.2")
    return value


def _units(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= 100:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 100")
    return int(text)


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("tag_pose"), help="folder for tables and plots")
    parser.add_argument("--panel", choices=TAGS, default="bundle", help="the panel on the pictures")
    parser.add_argument("--pictures", type=Path, help="folder with pictures; left out: the simulation takes them")
    parser.add_argument("--units", type=_units, default=5, help="sensors with errors of their own")
    parser.add_argument("--seed", type=int, default=0, help="of poses, sensors and noise")
    parser.add_argument("--focal-error", type=_share, default=0.01, help="of the focal length, as a share of it")
    parser.add_argument("--depth-bias", type=_share, default=0.01, help="added to every depth [m]")
    return parser.parse_args(arguments)
