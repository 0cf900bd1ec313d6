"""Errors of marker board poses against the truth, by distance and tilt, as tables; and of whole calibrations. Three
errors are reported: of the board's centre, of its orientation, and of a point REACH_M away from it, as of an object
that is grasped there (root mean square over all directions)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Callable, Optional

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from common.camera_model import CameraModel
from common.poses import inverse, pose, read_only
from common.rotations import rotation_angle
from vision.calibration.acceptance import BoardDetection, CalibrationConfig, judge, view_from
from vision.calibration.arm_model import ArmModel
from vision.calibration.hand_eye import CalibrationView
from vision.marker_board.plane_pose import PoseEstimate, RgbdPose

METHODS = ("colour", "plane", "fused")
REACH_M = 0.5
CSV_HEAD = (
    "variant,distance_m,tilt_deg,method,pictures,found,position_mm_median,position_mm_95,rotation_deg_median,"
    "rotation_deg_95,reach_mm_median,reach_mm_95,normalised_square_mean"
)
Arm = Callable[[np.ndarray], Optional[np.ndarray]]
"""The pose that an arm reports where its flange truly is at the given one, both of shape (4, 4) [m]; None: out of its
reach."""


@dataclass(frozen=True)
class PoseErrors:
    """Errors of one pose."""

    position: float  # of the centre [mm]
    rotation: float  # of the orientation [deg]
    reach: float  # of a point REACH_M away [mm]
    square: float  # squared error over covariance and 6 degrees of freedom; about 1 if these are right


@dataclass(frozen=True)
class PoseTrial:
    """One pair of images."""

    distance: float  # of the marker board [m]
    tilt: float  # between its normal and the line of sight [deg]
    errors: dict[str, PoseErrors]  # by method; a method without a pose is missing


def trial(distance: float, tilt: float, T_truth: np.ndarray, poses: RgbdPose | None) -> PoseTrial:
    """Returns the errors of the poses against T_truth, shape (4, 4) [m]; None: no tag was detected."""
    found = {} if poses is None else {name: getattr(poses, name) for name in METHODS}
    return PoseTrial(distance, tilt, {name: errors_of(T_truth, e) for name, e in found.items() if e is not None})


def cells(trials: list[PoseTrial]) -> list[tuple[float, float]]:
    return sorted({(t.distance, t.tilt) for t in trials})


def values(
    trials: list[PoseTrial], method: str, quantity: str, distance: float | None = None, tilt: float | None = None
) -> np.ndarray:
    """Returns a quantity of PoseErrors for all trials with a pose, filtered by distance and tilt if given."""
    chosen = (t for t in trials if distance in (None, t.distance) and tilt in (None, t.tilt))
    return np.array([getattr(t.errors[method], quantity) for t in chosen if method in t.errors])


def markdown(trials: list[PoseTrial], methods: tuple[str, ...] = METHODS) -> list[str]:
    """Returns a table by distance and tilt with the median / 95 % of position, rotation and reach of each method."""
    titles = [f"{method} {unit}" for method in methods for unit in ("mm", "deg", f"mm at {REACH_M:g} m")]
    lines = ["| distance, tilt | " + " | ".join(titles) + " |", "|" + "---|" * (len(titles) + 1)]
    for distance, tilt in [*cells(trials), (None, None)]:
        texts = ["all" if distance is None else f"{distance:g} m, {tilt:g} deg"]
        for method in methods:
            for quantity, digits in (("position", 1), ("rotation", 2), ("reach", 1)):
                found = values(trials, method, quantity, distance, tilt)
                middle, high = np.percentile(found, (50, 95)) if found.size else (np.nan, np.nan)
                texts.append(f"{middle:.{digits}f} / {high:.{digits}f}" if found.size else "-")
        lines.append("| " + " | ".join(texts) + " |")
    return lines


def csv(variant: str, trials: list[PoseTrial]) -> list[str]:
    lines = []
    for distance, tilt in cells(trials):
        count = sum((t.distance, t.tilt) == (distance, tilt) for t in trials)
        for method in METHODS:
            found = {q: values(trials, method, q, distance, tilt) for q in ("position", "rotation", "reach", "square")}
            squares = found.pop("square")
            columns = [variant, f"{distance:g}", f"{tilt:g}", method, str(count), str(squares.size)]
            for v in found.values():
                columns += [f"{np.median(v):.4f}", f"{np.percentile(v, 95):.4f}"] if v.size else ["", ""]
            columns.append(f"{squares.mean():.3f}" if squares.size else "")
            lines.append(",".join(columns))
    return lines


def errors_of(T: np.ndarray, estimate: PoseEstimate) -> PoseErrors:
    """Returns the errors of an estimate, where the truth is T, shape (4, 4) [m]."""
    shift = estimate.T_camera_board[:3, 3] - T[:3, 3]
    R = estimate.T_camera_board[:3, :3] @ T[:3, :3].T
    angle = rotation_angle(R)
    error = np.concatenate((shift, pin.log3(R)))
    reach = np.sqrt(shift @ shift + 2.0 / 3.0 * (REACH_M * angle) ** 2)
    square = error @ np.linalg.solve(estimate.covariance, error) / 6.0
    return PoseErrors(1e3 * float(np.linalg.norm(shift)), float(np.degrees(angle)), 1e3 * float(reach), float(square))


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """A detection of the marker board with its true pose in the camera, shape (4, 4) [m]."""

    T_truth: np.ndarray
    detection: BoardDetection


@dataclass(frozen=True)
class CalibrationAccuracy:
    """Errors of one calibration."""

    position: float  # of the camera [mm]
    rotation: float  # of the camera [deg]
    point: float  # of a point in the middle of the views, at its true depth, as the camera measures it [mm]
    stated: float  # standard deviation of that point by the calibration [mm]
    accepted: bool  # whether the calibration passed its checks


def wrong_lens(camera: CameraModel, focal: float, centre: float = 0.0) -> CameraModel:
    """Returns the camera with its focal length wrong by the fraction `focal`, its centre by `centre` [px] along x."""
    K = camera.K.copy()
    K[[0, 1], [0, 1]] *= 1.0 + focal
    K[0, 2] += centre
    return replace(camera, K=read_only(K))


def inexact_arm(shift: float, turn: float, rng: np.random.Generator) -> Arm:
    """Returns an arm that reports each pose with other errors, with these standard deviations along and about each axis
    [m, rad]."""

    def reported(T: np.ndarray) -> np.ndarray:
        moved, turned = shift * rng.normal(size=3), turn * rng.normal(size=3)
        return pose(pin.exp3(turned) @ T[:3, :3], T[:3, 3] + moved)

    return reported


def bent_arm(drawn: ArmModel, q_seed: ArrayLike, shift: float, turn: float, rng: np.random.Generator) -> Arm:
    """Returns an arm with errors at each joint (ArmModel.bent) that reports what the arm as drawn would; it comes to a
    pose from the joints `q_seed`, shape (7,) [rad]."""
    built = drawn.bent(shift, turn, rng)

    def reported(T: np.ndarray) -> np.ndarray | None:
        q = drawn.joints_for(T, q_seed)  # those of the true arm are the same but for its small errors
        return None if q is None else T @ inverse(built.flange(q)) @ drawn.flange(q)

    return reported


def calibrate(
    observations: list[BoardObservation],
    T_base_camera: np.ndarray,
    T_flange_board: np.ndarray,
    config: CalibrationConfig,
    arm: Arm,
    lens: tuple[CameraModel, CameraModel] | None = None,
) -> CalibrationAccuracy:
    """Returns the errors of the calibration from observations, each of them a view of one image within the arm's reach.
    T_base_camera: where the camera truly stands, T_flange_board, both shape (4, 4) [m]; `lens`: the true one and that
    of the observations, where they differ."""
    views: list[CalibrationView] = []
    for observation in observations:
        measured = arm(T_base_camera @ observation.T_truth @ inverse(T_flange_board))
        if measured is None:
            raise ValueError("a view is out of the arm's reach")
        views.append(view_from([observation.detection], measured, views, config))
    verdict = judge(views, T_flange_board, config)
    found = verdict.result.T_base_camera
    middle = np.mean([observation.T_truth[:3, 3] for observation in observations], axis=0)
    seen = middle
    if lens is not None:
        ray = lens[1].rays(lens[0].project(middle[None]))[0]
        seen = ray * middle[2] / ray[2]
    apart = found[:3, :3] @ seen + found[:3, 3] - T_base_camera[:3, :3] @ middle - T_base_camera[:3, 3]
    return CalibrationAccuracy(
        position=1e3 * float(np.linalg.norm(found[:3, 3] - T_base_camera[:3, 3])),
        rotation=float(np.degrees(rotation_angle(found[:3, :3] @ T_base_camera[:3, :3].T))),
        point=1e3 * float(np.linalg.norm(apart)),
        stated=verdict.point_sd_mm,
        accepted=verdict.accepted,
    )
