"""The program `evaluate_calibration.py`: what the photometric refinement gains, in pictures with known truth.

First the pose of the panel in single pictures, then whole calibrations of which each view is such a picture. Needs no
ROS master.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from apriltag_ros.detector import TagDetector
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import detector_settings
from common.config import parse
from common.errors import DeviceError, RigError
from vision.calibration.acceptance import CalibrationConfig, Sight
from vision.calibration.evaluation import Shown, calibrate
from vision.marker_board.board import PanelConfig
from vision.marker_board.plane_pose import Estimate
from vision.marker_board.pose_evaluation import Trial, errors_of, markdown, values
from vision.ros.marker_board.image_folder import TAGS, config, panel_target, read_pictures, take_pictures

NAME = "evaluate_calibration"
METHODS = ("corners", "refined")
PANELS = {"bundle": "panel.yaml", "single": "panel_single.yaml"}
POSES = ("--distances", "0.5", "0.75", "1", "1.5", "2", "--tilts", "0", "20", "40", "60", "--pictures", "2")
VIEWS = ("--distances", "0.6", "0.8", "1", "--tilts", "22", "33", "44", "--pictures", "4")
VIEW_COUNT = 15


def main(arguments: list[str] | None = None) -> int:
    """Evaluates; returns the exit code."""
    options = _options(arguments)
    cv2.setNumThreads(1)
    more = ["--seed", str(options.seed), "--units", "3"]
    if options.config is not None:
        more += ["--config", str(options.config)]
    try:
        for kind, poses in (("poses", POSES), ("views", VIEWS)):
            with tempfile.TemporaryDirectory(prefix=NAME) as folder:
                take_pictures(Path(folder), options.panel, *poses, *more)
                trials, shown, refusals = _look(Path(folder), options.panel)
            if kind == "poses":
                print("\n".join(markdown(trials, METHODS)))
                for method in METHODS:
                    square = np.median(values(trials, method, "square"))
                    print(f"{method}: median of the squared error in its own standard deviations {square:.2f}")
                for sentence in refusals:
                    print(f"not refined: {sentence}")
            else:
                _whole(options, shown)
    except (RigError, OSError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    return 0


def _look(folder: Path, panel: str) -> tuple[list[Trial], dict[str, list[Shown]], list[str]]:
    """Returns the errors in all pictures, what was found by each method, and a sentence for each picture that was not
    refined, for which the pose by the corners stands."""
    pictures, target = read_pictures(folder), panel_target(panel)
    settings = detector_settings({**config("settings.yaml"), "rectified": False})
    detector, refiner = TagDetector(settings, (target,)), PhotometricRefiner(settings.tag_family, target)
    trials, refusals = [], []
    shown: dict[str, list[Shown]] = {method: [] for method in METHODS}
    for moment, pair in enumerate(pictures.pairs()):  # a second apart: no pose is known from the picture before
        found = detector.detect(pair.grey, pictures.rgb, float(moment)).targets
        if not found:
            trials.append(Trial(pair.distance, pair.tilt, {}))
            continue
        corners = Sight(found[0].pose.T_camera_tag, found[0].pose.covariance)
        better = refiner.refine(pair.grey, pictures.rgb, corners.T_camera_panel)
        if better.refused:
            refusals.append(f"{pair.distance:g} m, {pair.tilt:g} deg: {better.refused}")
            refined = corners
        else:
            refined = Sight(better.T_camera_tag, better.covariance)
        errors = {}
        for method, sight in zip(METHODS, (corners, refined)):
            errors[method] = errors_of(pair.T_rgb_panel, Estimate(sight.T_camera_panel, sight.covariance))
            shown[method].append(Shown(pair.T_rgb_panel, sight))
        trials.append(Trial(pair.distance, pair.tilt, errors))
    return trials, shown, refusals


def _whole(options: argparse.Namespace, shown: dict[str, list[Shown]]) -> None:
    """Prints the errors of whole calibrations, each from views drawn at random, the same for both methods."""
    limits = parse(CalibrationConfig, config("camera_calibration.yaml"))
    limits = replace(limits, pictures=1, new_mm=0.0, new_deg=0.0)
    T_flange_panel = parse(PanelConfig, config(PANELS[options.panel])).T_flange_tag
    stated = (1e-3 * limits.arm_mm, float(np.radians(limits.arm_deg)))
    count = len(shown[METHODS[0]])
    if count < VIEW_COUNT:
        raise DeviceError(f"The panel was found in {count} pictures, {VIEW_COUNT} are needed.")
    print(f"\n| calibration from {VIEW_COUNT} views | camera mm | deg | point mm | stated mm | good |")
    print("|---|---|---|---|---|---|")
    for arm_name, arm in (
        ("exact arm", (0.0, 0.0)),
        (f"arm off by {limits.arm_mm:g} mm, {limits.arm_deg:g} deg", stated),
    ):
        for method in METHODS:
            rng = np.random.default_rng(options.seed)
            found = []
            for _ in range(options.draws):
                drawn = rng.choice(count, VIEW_COUNT, replace=False)
                found.append(calibrate([shown[method][i] for i in drawn], T_flange_panel, limits, arm, rng))
            cells = [
                f"{np.median(v):.2f} / {np.percentile(v, 95):.2f}"
                for v in ([getattr(f, name) for f in found] for name in ("position", "rotation", "point"))
            ]
            told, good = np.median([f.stated for f in found]), np.mean([f.accepted for f in found])
            print(f"| {method}, {arm_name} | {' | '.join(cells)} | {told:.2f} | {good:.0%} |")


def _options(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--panel", choices=TAGS, default="bundle", help="the panel on the pictures")
    parser.add_argument("--config", type=Path, help="yaml file with the errors of the simulated camera")
    parser.add_argument("--draws", type=_draws, default=100, help="calibrations for each line of the table")
    parser.add_argument("--seed", type=int, default=0, help="of poses, noise and draws")
    return parser.parse_args(arguments)


def _draws(text: str) -> int:
    if not text.isdecimal() or not 0 < int(text) <= 10000:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1 to 10000")
    return int(text)
