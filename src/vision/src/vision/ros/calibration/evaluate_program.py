"""The program `evaluate_calibration.py`: measures the gain of the photometric refinement in images with known truth.

It evaluates the pose of the marker board in single images, then whole calibrations in which each view is one such
image. It needs no ROS master.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from apriltag_ros.detector import TagDetector
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import detector_settings
from common.config import parse
from common.errors import DeviceError, RigError
from vision.calibration.acceptance import BoardDetection, CalibrationConfig
from vision.marker_board.board import MarkerBoardConfig
from vision.marker_board.plane_pose import PoseEstimate
from vision.marker_board.pose_evaluation import BoardObservation, PoseTrial, calibrate, errors_of, markdown, values
from vision.ros.marker_board.image_folder import TAGS, board_target, read_config, read_images, rendered_images
from vision.ros.number_arguments import whole

NAME = "evaluate_calibration"
METHODS = ("corners", "refined")
BOARDS = {"bundle": "panel.yaml", "single": "panel_single.yaml"}
POSES = ("--distances", "0.5", "0.75", "1", "1.5", "2", "--tilts", "0", "20", "40", "60", "--pictures", "2")
VIEWS = ("--distances", "0.6", "0.8", "1", "--tilts", "22", "33", "44", "--pictures", "4")
VIEW_COUNT = 15


def main(arguments: list[str] | None = None) -> int:
    """Evaluates; returns the exit code."""
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--panel", choices=TAGS, default="bundle", help="the marker board in the images")
    parser.add_argument("--config", type=Path, help="yaml file with the errors of the simulated camera")
    parser.add_argument("--draws", type=whole(1, 10000), default=100, help="calibrations for each line of the table")
    parser.add_argument("--seed", type=int, default=0, help="seed of poses, noise and draws")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    more = ["--seed", str(options.seed), "--units", "3"]
    if options.config is not None:
        more += ["--config", str(options.config)]
    try:
        with rendered_images(options.panel, *POSES, *more) as folder:
            _print_poses(*_evaluate(folder, options.panel))
        with rendered_images(options.panel, *VIEWS, *more) as folder:
            _print_calibrations(options, _evaluate(folder, options.panel)[1])
    except (RigError, OSError) as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 1
    return 0


def _evaluate(folder: Path, board: str) -> tuple[list[PoseTrial], dict[str, list[BoardObservation]], list[str]]:
    """Returns the errors in all images, the observations by method, and a sentence for each image left unrefined."""
    images, target = read_images(folder), board_target(board)
    settings = detector_settings({**read_config("settings.yaml"), "rectified": False})
    detector, refiner = TagDetector(settings, (target,)), PhotometricRefiner(settings.tag_family, target)
    trials, rejections = [], []
    observations: dict[str, list[BoardObservation]] = {method: [] for method in METHODS}
    for moment, pair in enumerate(images.pairs()):  # a second apart: no orientation is known from the image before
        found = detector.detect(pair.grey, images.rgb, float(moment)).targets
        if not found:
            trials.append(PoseTrial(pair.distance, pair.tilt, {}))
            continue
        corners = refined = BoardDetection(found[0].pose.T_camera_tag, found[0].pose.covariance)
        better = refiner.refine(pair.grey, images.rgb, corners.T_camera_board)
        if better.covariance is None:
            rejections.append(f"{pair.distance:g} m, {pair.tilt:g} deg: {better.rejection}")
        else:
            refined = BoardDetection(better.T_camera_tag, better.covariance)
        errors = {}
        for method, detection in zip(METHODS, (corners, refined)):
            estimate = PoseEstimate(detection.T_camera_board, detection.covariance)
            errors[method] = errors_of(pair.T_rgb_board, estimate)
            observations[method].append(BoardObservation(pair.T_rgb_board, detection))
        trials.append(PoseTrial(pair.distance, pair.tilt, errors))
    return trials, observations, rejections


def _print_poses(trials: list[PoseTrial], _: object, rejections: list[str]) -> None:
    print("\n".join(markdown(trials, METHODS)))
    for method in METHODS:
        square = np.median(values(trials, method, "square"))
        print(f"{method}: median of the squared error in its own standard deviations {square:.2f}")
    for sentence in rejections:
        print(f"not refined: {sentence}")


def _print_calibrations(options: argparse.Namespace, observations: dict[str, list[BoardObservation]]) -> None:
    """Prints the errors of whole calibrations, each from random views, the same for both methods."""
    limits = parse(CalibrationConfig, read_config("camera_calibration.yaml"))
    limits = replace(limits, pictures=1, new_mm=0.0, new_deg=0.0)
    T_flange_board = parse(MarkerBoardConfig, read_config(BOARDS[options.panel])).T_flange_tag
    stated = (1e-3 * limits.arm_mm, float(np.radians(limits.arm_deg)))
    count = len(observations[METHODS[0]])
    if count < VIEW_COUNT:
        raise DeviceError(f"The marker board was detected in {count} images, but {VIEW_COUNT} are needed.")
    print(f"\n| calibration from {VIEW_COUNT} views | camera mm | deg | point mm | stated mm | good |")
    print("|---|---|---|---|---|---|")
    for arm_name, arm in (
        ("exact arm", (0.0, 0.0)),
        (f"arm off by {limits.arm_mm:g} mm, {limits.arm_deg:g} deg", stated),
    ):
        for method in METHODS:
            rng = np.random.default_rng(options.seed)
            results = []
            for _ in range(options.draws):
                drawn = rng.choice(count, VIEW_COUNT, replace=False)
                chosen = [observations[method][i] for i in drawn]
                results.append(calibrate(chosen, T_flange_board, limits, arm, rng))
            columns = [
                f"{np.median(v):.2f} / {np.percentile(v, 95):.2f}"
                for v in ([getattr(r, name) for r in results] for name in ("position", "rotation", "point"))
            ]
            sd, good = np.median([r.stated for r in results]), np.mean([r.accepted for r in results])
            print(f"| {method}, {arm_name} | {' | '.join(columns)} | {sd:.2f} | {good:.0%} |")
