"""How far calibrations of the camera's place are from the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.poses import inverse, pose
from common.rotations import rotation_angle
from vision.calibration.acceptance import CalibrationConfig, Sight, judge, view_from
from vision.calibration.hand_eye import View

T_BASE_CAMERA = pose([[-0.5, 0.0, -np.sqrt(0.75)], [np.sqrt(0.75), 0.0, -0.5], [0.0, -1.0, 0.0]], (1.1, 0.2, 0.7))
"""Where the camera stands in truth; which place that is does not matter."""


@dataclass(frozen=True, eq=False)
class Shown:
    """The panel in a picture.

    Attributes:
        T_truth: in the camera, shape (4, 4) [m].
        sight: what was found.
    """

    T_truth: np.ndarray
    sight: Sight


@dataclass(frozen=True)
class CalibrationError:
    """Of one calibration.

    Attributes:
        position: of the camera [mm].
        rotation: of the camera [deg].
        point: of a point in the middle of the views, as the camera sees it [mm].
        stated: standard deviation of that point, as the calibration states it [mm].
        accepted: whether the verdict was good.
    """

    position: float
    rotation: float
    point: float
    stated: float
    accepted: bool


def calibrate(
    pictures: list[Shown],
    T_flange_panel: np.ndarray,
    config: CalibrationConfig,
    arm: tuple[float, float],
    rng: np.random.Generator,
) -> CalibrationError:
    """Returns the error of the calibration from pictures, each of them a view.

    Args:
        pictures: of the panel.
        T_flange_panel: shape (4, 4) [m].
        config: limits of the calibration; a view has one picture here.
        arm: standard deviations of the arm's errors along and about each axis [m, rad].
        rng: source of these errors.
    """
    views: list[View] = []
    for shown in pictures:
        T_base_flange = T_BASE_CAMERA @ shown.T_truth @ inverse(T_flange_panel)
        shift, turn = (sd * rng.normal(size=3) for sd in arm)
        told = pose(pin.exp3(turn) @ T_base_flange[:3, :3], T_base_flange[:3, 3] + shift)
        views.append(view_from([shown.sight], told, views, config))
    verdict = judge(views, T_flange_panel, config)
    off = verdict.result.T_base_camera @ inverse(T_BASE_CAMERA)
    middle = np.mean([(T_BASE_CAMERA @ shown.T_truth)[:3, 3] for shown in pictures], axis=0)
    return CalibrationError(
        position=1e3 * float(np.linalg.norm(verdict.result.T_base_camera[:3, 3] - T_BASE_CAMERA[:3, 3])),
        rotation=float(np.degrees(rotation_angle(off[:3, :3]))),
        point=1e3 * float(np.linalg.norm(off[:3, :3] @ middle + off[:3, 3] - middle)),
        stated=verdict.point_sd_mm,
        accepted=verdict.accepted,
    )
