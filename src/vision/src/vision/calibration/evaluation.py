"""Errors of calibrations that are made from detections with known truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.poses import inverse, pose
from common.rotations import rotation_angle
from vision.calibration.acceptance import BoardDetection, CalibrationConfig, judge, view_from
from vision.calibration.hand_eye import CalibrationView

T_BASE_CAMERA = pose([[-0.5, 0.0, -np.sqrt(0.75)], [np.sqrt(0.75), 0.0, -0.5], [0.0, -1.0, 0.0]], (1.1, 0.2, 0.7))
"""The true camera pose; the choice does not matter."""


@dataclass(frozen=True, eq=False)
class BoardObservation:
    """A detection of the marker board with its true pose in the camera, shape (4, 4) [m]."""

    T_truth: np.ndarray
    detection: BoardDetection


@dataclass(frozen=True)
class CalibrationAccuracy:
    """Errors of one calibration."""

    position: float  # of the camera [mm], [deg]
    rotation: float  # of the camera [mm], [deg]
    point: float  # of a point in the middle of the views, as the camera measures it [mm]
    stated: float  # standard deviation of that point by the calibration [mm]
    accepted: bool  # whether the calibration passed its checks


def calibrate(
    observations: list[BoardObservation],
    T_flange_board: np.ndarray,
    config: CalibrationConfig,
    arm: tuple[float, float],
    rng: np.random.Generator,
) -> CalibrationAccuracy:
    """Returns the errors of the calibration from observations, each of them a view of one image.

    Args:
        T_flange_board: shape (4, 4) [m].
        arm: standard deviations of the arm's errors along and about each axis [m, rad].
        rng: source of these errors.
    """
    views: list[CalibrationView] = []
    for observation in observations:
        T_base_flange = T_BASE_CAMERA @ observation.T_truth @ inverse(T_flange_board)
        shift, turn = (sd * rng.normal(size=3) for sd in arm)
        measured = pose(pin.exp3(turn) @ T_base_flange[:3, :3], T_base_flange[:3, 3] + shift)
        views.append(view_from([observation.detection], measured, views, config))
    verdict = judge(views, T_flange_board, config)
    off = verdict.result.T_base_camera @ inverse(T_BASE_CAMERA)
    middle = np.mean([(T_BASE_CAMERA @ observation.T_truth)[:3, 3] for observation in observations], axis=0)
    return CalibrationAccuracy(
        position=1e3 * float(np.linalg.norm(verdict.result.T_base_camera[:3, 3] - T_BASE_CAMERA[:3, 3])),
        rotation=float(np.degrees(rotation_angle(off[:3, :3]))),
        point=1e3 * float(np.linalg.norm(off[:3, :3] @ middle + off[:3, 3] - middle)),
        stated=verdict.point_sd_mm,
        accepted=verdict.accepted,
    )
