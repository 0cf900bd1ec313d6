"""The program `evaluate_calibration.py`: the accuracy of calibrations, by images of the marker board with known truth.

It evaluates the pose of the marker board in single images, by its corners and refined, then whole calibrations in which
each view is one such image: with an exact arm, one that errs in each view, one that was not built exactly, and this
with a camera whose calibration file is wrong. It needs no ROS master.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Dict, List

import cv2
import numpy as np

from apriltag_ros.detector import TagDetector
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import detector_settings
from common.command_line import exit_code, real, whole
from common.config import parse
from common.errors import DeviceError
from common.poses import inverse
from rig_description.urdf import urdf
from vision.calibration.acceptance import BoardDetection, CalibrationConfig
from vision.calibration.arm_model import ArmModel
from vision.calibration.view_planner import ViewsConfig, guessed_camera
from vision.marker_board.board import MarkerBoardConfig
from vision.marker_board.plane_pose import PoseEstimate
from vision.marker_board.pose_evaluation import (
    Arm,
    BoardObservation,
    PoseTrial,
    bent_arm,
    calibrate,
    errors_of,
    inexact_arm,
    markdown,
    values,
    wrong_lens,
)
from vision.ros.marker_board.image_folder import TAGS, board_target, read_config, read_images, rendered_images

NAME = "evaluate_calibration"
METHODS = ("corners", "refined")
BOARDS = {"bundle": "panel.yaml", "single": "panel_single.yaml"}
POSES = ("--distances", "0.5", "0.75", "1", "1.5", "2", "--tilts", "0", "20", "40", "60", "--pictures", "2")
VIEWS = ("--distances", "0.6", "0.8", "1", "--tilts", "22", "33", "44", "--pictures", "4")
VIEW_COUNT = 15
ARM = ("LBR7R800", "MF_elektrisch")


def main(arguments: list[str] | None = None) -> int:
    """Evaluates; returns the exit code."""
    parser = argparse.ArgumentParser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--panel", choices=TAGS, default="bundle", help="the marker board in the images")
    parser.add_argument("--config", type=Path, help="yaml file with the errors of the simulated camera")
    parser.add_argument("--draws", type=whole(1, 10000), default=100, help="calibrations for each line of the table")
    parser.add_argument("--focal-error", type=real(-0.2, 0.2), default=0.01, help="of a wrong lens, relative")
    parser.add_argument("--centre-error", type=real(-50.0, 50.0), default=3.0, help="of its image centre [px]")
    parser.add_argument("--bend-mm", type=real(0.0, 10.0), default=0.3, help="error of each joint's place [mm]")
    parser.add_argument("--bend-deg", type=real(0.0, 5.0), default=0.05, help="error of each joint's axis [deg]")
    parser.add_argument("--seed", type=int, default=0, help="seed of poses, noise and draws")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    more = ["--seed", str(options.seed), "--units", "3"]
    if options.config is not None:
        more += ["--config", str(options.config)]

    def evaluate() -> None:
        with rendered_images(options.panel, *POSES, *more) as folder:
            _print_poses(*_evaluate(folder, options.panel))
        with rendered_images(options.panel, *VIEWS, *more) as folder:
            _print_calibrations(options, folder)

    return exit_code(NAME, evaluate)


Observations = Dict[str, List[BoardObservation]]
"""By method."""


def _evaluate(
    folder: Path, board: str, focal: float = 0.0, centre: float = 0.0
) -> tuple[list[PoseTrial], Observations, list[str]]:
    """Returns the errors in all images, seen with a wrong lens, the observations, and a sentence for each image left
    unrefined."""
    images, target = read_images(folder), board_target(board)
    rgb = wrong_lens(images.rgb, focal, centre)
    settings = detector_settings({**read_config("settings.yaml"), "rectified": False})
    detector, refiner = TagDetector(settings, (target,)), PhotometricRefiner(settings.tag_family, target)
    trials, rejections = [], []
    observations: dict[str, list[BoardObservation]] = {method: [] for method in METHODS}
    for moment, pair in enumerate(images.pairs()):  # a second apart: no orientation is known from the image before
        found = detector.detect(pair.grey, rgb, float(moment)).targets
        if not found:
            trials.append(PoseTrial(pair.distance, pair.tilt, {}))
            continue
        corners = refined = BoardDetection(found[0].pose.T_camera_tag, found[0].pose.covariance)
        better = refiner.refine(pair.grey, rgb, corners.T_camera_board)
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


def _print_calibrations(options: argparse.Namespace, folder: Path) -> None:
    """Prints the errors of whole calibrations, each from random views, the same for both methods."""
    limits = parse(CalibrationConfig, read_config("camera_calibration.yaml"))
    limits = replace(limits, pictures=1, new_mm=0.0, new_deg=0.0)
    board = parse(MarkerBoardConfig, read_config(BOARDS[options.panel]))
    places = parse(ViewsConfig, read_config("calibration_views.yaml"))
    T_base_camera, q_start = guessed_camera(places, np.eye(3)), np.radians(places.start)
    drawn, rgb = ArmModel(urdf(*ARM)), read_images(folder).rgb
    stated = limits.arm_mm, limits.arm_deg
    bend = options.bend_mm, options.bend_deg
    exact, wrong = (0.0, 0.0), (options.focal_error, options.centre_error)

    def inexact(mm: float, deg: float, rng: np.random.Generator) -> Arm:
        return inexact_arm(1e-3 * mm, np.radians(deg), rng)

    def bent(mm: float, deg: float, rng: np.random.Generator) -> Arm:
        return bent_arm(drawn, q_start, 1e-3 * mm, np.radians(deg), rng)

    lens_name = f"lens off by {wrong[0]:.1%}, {wrong[1]:g} px"
    rows: tuple[tuple[str, tuple[float, float], Callable[..., Arm], tuple[float, float]], ...] = (
        ("exact arm", exact, inexact, exact),
        ("arm off by {} mm, {} deg in each view".format(*stated), exact, inexact, stated),
        ("joints off by {} mm, {} deg".format(*bend), exact, bent, bend),
        (f"exact arm, {lens_name}", wrong, inexact, exact),
        ("joints off by {} mm, {} deg, ".format(*bend) + lens_name, wrong, bent, bend),
    )
    seen = {lens: _within_reach(_evaluate(folder, options.panel, *lens)[1], T_base_camera, board, drawn, q_start)
            for lens in (exact, wrong)}  # fmt: skip
    print(f"\n| calibration from {VIEW_COUNT} views | camera mm | deg | point mm | stated mm | good |")
    print("|---|---|---|---|---|---|")
    for name, lens, arm, errors in rows:
        for method in METHODS:
            rng = np.random.default_rng(options.seed)
            results = []
            for _ in range(options.draws):
                views = seen[lens][method]
                chosen = [views[i] for i in rng.choice(len(views), VIEW_COUNT, replace=False)]
                cameras = rgb, wrong_lens(rgb, *lens)
                draw = arm(*errors, rng)
                results.append(calibrate(chosen, T_base_camera, board.T_flange_tag, limits, draw, cameras))
            columns = [
                f"{np.median(v):.2f} / {np.percentile(v, 95):.2f}"
                for v in ([getattr(r, name) for r in results] for name in ("position", "rotation", "point"))
            ]
            sd, good = np.median([r.stated for r in results]), np.mean([r.accepted for r in results])
            print(f"| {method}, {name} | {' | '.join(columns)} | {sd:.2f} | {good:.0%} |", flush=True)


def _within_reach(
    seen: Observations, T_base_camera: np.ndarray, board: MarkerBoardConfig, arm: ArmModel, q_seed: np.ndarray
) -> Observations:
    """Returns the observations in which the arm can hold the board; raises DeviceError if there are too few."""
    reached = {}
    for method, observations in seen.items():
        poses = (T_base_camera @ observation.T_truth @ inverse(board.T_flange_tag) for observation in observations)
        reached[method] = [o for o, T in zip(observations, poses) if arm.joints_for(T, q_seed) is not None]
    least = min(map(len, reached.values()))
    if least < VIEW_COUNT:
        raise DeviceError(f"{least} images show the marker board in the arm's reach, but {VIEW_COUNT} are needed.")
    return reached
