"""Which views a calibration uses, and whether its result is accepted. A view is the mean pose of the marker board over
several images while arm and camera stand still. Its covariance is that of one image, because most of a corner's error
is the same in every image, plus that of the arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from apriltag_ros.photometric import PhotometricRefiner
from common.camera_model import CameraModel
from common.config import flag, integer, number
from common.poses import inverse, pose
from common.rotations import rotation_angle
from vision.calibration import hand_eye
from vision.calibration.hand_eye import CalibrationView, DegenerateViews, HandEyeSolution


@dataclass(frozen=True)
class CalibrationConfig:
    """The schema of camera_calibration.yaml."""

    pictures: int = integer(low=1, high=100, doc="detections of the marker board in a view")
    photometric: bool = flag("refine these detections by all grey values of the tags, not only by their corners")
    still_mm: float = number("mm", above=0.0, high=100.0, doc="maximum distance of a detection from their mean")
    still_deg: float = number("deg", above=0.0, high=30.0, doc="maximum rotation of a detection from their mean")
    new_mm: float = number("mm", low=0.0, high=1000.0, doc="a view is a repetition if it is nearer to an earlier one")
    new_deg: float = number("deg", low=0.0, high=90.0, doc="and rotated by less than this")
    arm_mm: float = number("mm", low=0.0, high=10.0, doc="standard deviation of the measured flange position")
    arm_deg: float = number("deg", low=0.0, high=5.0, doc="standard deviation of the measured flange orientation")
    min_views: int = integer(low=4, high=100, doc="minimum number of consistent views")
    min_share: float = number(above=0.5, high=1.0, doc="minimum fraction of consistent views")
    max_rms_mm: float = number("mm", above=0.0, high=50.0, doc="maximum rms position error of the views")
    max_rms_deg: float = number("deg", above=0.0, high=10.0, doc="maximum rms orientation error of the views")
    max_point_sd_mm: float = number("mm", above=0.0, high=50.0, doc="maximum standard deviation of a board point")
    max_turn_sd_deg: float = number("deg", above=0.0, high=10.0, doc="maximum standard deviation of the orientation")
    max_scale: float = number(above=0.0, high=0.2, doc="maximum fraction by which size or distance may be wrong")
    max_panel_mm: float = number("mm", above=0.0, high=100.0, doc="maximum distance of the board from its drawing")
    max_panel_deg: float = number("deg", above=0.0, high=90.0, doc="maximum rotation of the board from its drawing")


@dataclass(frozen=True, eq=False)
class BoardDetection:
    """The marker board in one image: its pose, shape (4, 4) [m], and the covariance of small changes, shape (6, 6)."""

    T_camera_board: np.ndarray
    covariance: np.ndarray


class ViewRejected(ValueError):
    """A view cannot be used; `cause` is "detections" (too few), "repeated", "moved" or "uncertain"."""

    def __init__(self, cause: str, sentence: str) -> None:
        self.cause = cause
        super().__init__(sentence)


@dataclass(frozen=True, eq=False)
class Verdict:
    """A calibration and whether it is good enough."""

    result: HandEyeSolution  # the calibration
    failed: dict[str, str]  # sentence of each failed check, by its limit or "dependence" (on a single view)
    rms: np.ndarray  # rms errors of the consistent views [mm, deg], shape (2,)
    predicted: np.ndarray  # distance of each view from the others' prediction [mm, deg], shape (n, 2); nan: unknown
    point_sd_mm: float  # standard deviation of a point in the middle of the board positions [mm]
    size: float  # factor by which everything appears too large, as with tags of a wrong size
    depth: float  # factor by which the marker board appears too far away, as with a wrong focal length
    board: np.ndarray  # distance of the marker board from its drawing [mm, deg], shape (2,)

    @property
    def accepted(self) -> bool:
        return not self.failed

    @property
    def sentence(self) -> str:
        fits = self.result.fits
        accuracy = (
            f"rms {self.rms[0]:.2f} mm and {self.rms[1]:.2f} deg in {int(fits.sum())} of {len(fits)} views, "
            f"standard deviation of a point at the marker board {self.point_sd_mm:.2f} mm"
        )
        if self.accepted:
            return f"The calibration is good: {accuracy}."
        return f"The calibration is rejected: {' '.join(self.failed.values())} ({accuracy}.)"


def refined(
    pairs: list[tuple[BoardDetection, np.ndarray]], camera: CameraModel, refiner: PhotometricRefiner
) -> tuple[list[BoardDetection], str]:
    """Returns the detections with refined poses and an empty string; or, if one image cannot be used, all of them
    unrefined, as the errors of both kinds differ, and the reason, without a full stop. Raises ValueError for an image
    without the camera's size. `pairs`: detections by the corners and their images, shape (height, width), uint8;
    `camera`: model of the raw images, distortion included."""
    better = []
    for detection, grey in pairs:
        result = refiner.refine(grey, camera, detection.T_camera_board)
        if result.covariance is None:
            return [detection for detection, _ in pairs], result.rejection
        better.append(replace(detection, T_camera_board=result.T_camera_tag, covariance=result.covariance))
    return better, ""


def view_from(
    detections: list[BoardDetection],
    T_base_flange: np.ndarray,
    earlier: list[CalibrationView],
    config: CalibrationConfig,
) -> CalibrationView:
    """Returns the view of `detections` at the measured flange pose, shape (4, 4) [m], given the `earlier` views in use.
    Raises ViewRejected if it cannot be used."""
    if len(detections) < config.pictures:
        found = f"the camera detected the marker board in {len(detections)} images"
        raise ViewRejected("detections", f"{found}, but a view needs {config.pictures}")
    for view in earlier:
        shift, turn = _distance(view.T_base_flange, T_base_flange)
        if shift < config.new_mm and turn < config.new_deg:
            near = f"the flange is only {shift:.1f} mm and {turn:.1f} deg from an earlier view"
            raise ViewRejected("repeated", f"{near}: tilt it another way")
    T = mean_pose([detection.T_camera_board for detection in detections])
    spread = np.max([_distance(T, detection.T_camera_board) for detection in detections], axis=0)
    if spread[0] > config.still_mm or spread[1] > config.still_deg:
        off = f"the detections are up to {spread[0]:.1f} mm and {spread[1]:.1f} deg from their mean"
        raise ViewRejected("moved", f"the marker board moved: {off}; stop the arm and take the view again")
    covariance = np.mean([detection.covariance for detection in detections], axis=0)
    arm = np.repeat([1e-3 * config.arm_mm, np.radians(config.arm_deg)], 3)
    return CalibrationView(T_base_flange, T, covariance + np.diag(arm**2))


def mean_pose(poses: list[np.ndarray]) -> np.ndarray:
    """Returns the mean, shape (4, 4), of poses that are close to each other."""
    first = poses[0]
    turn = np.mean([pin.log3(T[:3, :3] @ first[:3, :3].T) for T in poses], axis=0)
    return pose(pin.exp3(turn) @ first[:3, :3], np.mean([T[:3, 3] for T in poses], axis=0))


def judge(views: list[CalibrationView], T_flange_board: np.ndarray, config: CalibrationConfig) -> Verdict:
    """Returns the calibration from the views and the checks that it fails. T_flange_board is the pose of the marker
    board by its drawing, shape (4, 4) [m]. Raises DegenerateViews if the views do not determine the calibration."""
    if len(views) < config.min_views:
        raise DegenerateViews(f"{len(views)} views are too few: take at least {config.min_views}")
    result = hand_eye.solve(views)
    errors = result.errors[result.fits]
    unit = np.array([1e3, np.degrees(1.0)])
    rms = unit * np.sqrt([np.mean(np.sum(part**2, axis=1)) for part in (errors[:, :3], errors[:, 3:])])
    predicted = unit * hand_eye.leave_one_out(views, result)
    middle = np.mean([(view.T_base_flange @ result.T_flange_board)[:3, 3] for view in views], axis=0)
    point = 1e3 * hand_eye.point_sd(result, middle)
    turn = float(np.degrees(np.sqrt(np.trace(result.covariance[9:, 9:]))))
    board = np.array(_distance(T_flange_board, result.T_flange_board))
    (size, depth), sds = hand_eye.scales(views, result)
    count, fraction = int(result.fits.sum()), float(result.fits.mean())
    checks = {
        "min_views": (
            count >= config.min_views,
            f"Only {count} views are consistent, but {config.min_views} are needed: take more.",
        ),
        "min_share": (
            fraction >= config.min_share,
            f"Only {fraction:.0%} of the views are consistent, but {config.min_share:.0%} are needed: take them again, "
            "with arm and camera at rest.",
        ),
        "max_rms_mm": (
            rms[0] <= config.max_rms_mm,
            f"The views are off by {rms[0]:.2f} mm, the limit is {config.max_rms_mm:g} mm: check that board and camera "
            "are fixed.",
        ),
        "max_rms_deg": (
            rms[1] <= config.max_rms_deg,
            f"The views are off by {rms[1]:.2f} deg, the limit is {config.max_rms_deg:g} deg: check that board and "
            "camera are fixed.",
        ),
        **_uncertainty_checks(point, turn, config),
        "dependence": (
            not np.isnan(predicted[result.fits]).any(),
            "The result depends on a single view; add views that turn the flange about other axes.",
        ),
        "max_scale": (
            abs(size - 1.0) <= config.max_scale + 2.0 * sds[0],
            f"Everything appears {size - 1.0:+.1%} too large, the limit is {config.max_scale:.1%}: measure the tags.",
        ),
        "max_scale_depth": (
            abs(depth - 1.0) <= config.max_scale + 2.0 * sds[1],
            f"The marker board appears {depth - 1.0:+.1%} too far away, the limit is {config.max_scale:.1%}: calibrate "
            "the camera's focal length.",
        ),
        "max_panel": (
            board[0] <= config.max_panel_mm and board[1] <= config.max_panel_deg,
            f"The marker board would be {board[0]:.1f} mm and {board[1]:.1f} deg from its drawing, the limits are "
            f"{config.max_panel_mm:g} mm and {config.max_panel_deg:g} deg: check its mounting and the tag sizes.",
        ),
    }
    return Verdict(result, _failed(checks), rms, predicted, point, float(size), float(depth), board)


def check_alone(view: CalibrationView, config: CalibrationConfig) -> float:
    """Returns the standard deviation of a point at the marker board [mm] if a single view defines the camera pose;
    raises ViewRejected if that would be too uncertain."""
    point = 1e3 * float(np.sqrt(np.trace(view.covariance[:3, :3])))
    turn = float(np.degrees(np.sqrt(np.trace(view.covariance[3:, 3:]))))
    failed = _failed(_uncertainty_checks(point, turn, config))
    if failed:
        raise ViewRejected("uncertain", " ".join(failed.values()))
    return point


def table(verdict: Verdict) -> list[str]:
    lines = ["view   error [mm]  [deg]   error of the others' prediction [mm]  [deg]"]
    rows = zip(verdict.result.errors, verdict.predicted, verdict.result.fits)
    for i, (error, predicted, fits) in enumerate(rows, start=1):
        shift, turn = 1e3 * np.linalg.norm(error[:3]), np.degrees(np.linalg.norm(error[3:]))
        rest = f"{predicted[0]:34.2f}{predicted[1]:9.2f}" if fits else f"{'left out':>43}"
        lines.append(f"{i:4d}{shift:13.2f}{turn:7.2f}{rest}")
    return lines


def _uncertainty_checks(point: float, turn: float, config: CalibrationConfig) -> dict[str, tuple[bool, str]]:
    """Returns the checks of the standard deviations of a point [mm] and of the camera's orientation [deg]."""
    return {
        "max_point_sd_mm": (
            point <= config.max_point_sd_mm,
            f"The standard deviation of a point is {point:.2f} mm, the limit is {config.max_point_sd_mm:g} mm: tilt "
            "the marker board, or bring it nearer.",
        ),
        "max_turn_sd_deg": (
            turn <= config.max_turn_sd_deg,
            f"The standard deviation of the camera's orientation is {turn:.2f} deg, the limit is "
            f"{config.max_turn_sd_deg:g} deg: tilt the marker board, or bring it nearer.",
        ),
    }


def _failed(checks: dict[str, tuple[bool, str]]) -> dict[str, str]:
    return {key: sentence for key, (holds, sentence) in checks.items() if not holds}


def _distance(T: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Returns the distance between two poses [mm, deg]."""
    between = inverse(T) @ other
    return 1e3 * float(np.linalg.norm(between[:3, 3])), float(np.degrees(rotation_angle(between[:3, :3])))
