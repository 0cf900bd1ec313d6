"""A stored calibration: its result and accuracy, the hardware it belongs to, and the views to compute it from again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.config import choice, number, parse_part, text, vector
from common.errors import ConfigError
from common.poses import pose, read_only
from common.rotations import quaternion_from_rotation, rotation_from_quaternion
from vision.calibration.acceptance import Verdict
from vision.calibration.hand_eye import CalibrationView

VIEWS, LIVE = "views", "live"
AUTO, STORED = "auto", "stored"


@dataclass(frozen=True)
class CameraPoseConfig:
    """Private parameters of the node camera_place."""

    mode: str = choice(AUTO, STORED, LIVE, doc="source of the camera pose", absent=AUTO)
    detector: str = text(doc="name of the detector node", absent="apriltag_ros_continuous_node")


@dataclass(frozen=True, eq=False)
class CalibrationRecord:
    """The content of one file."""

    date: str  # as year-month-dayThour:minute:second
    kind: str  # VIEWS for a calibration by several views, LIVE for one by the board's drawing and a single view
    robot: str  # the arm and the media flange
    flange: str  # the arm and the media flange
    panel: str  # frame of the marker board
    camera: str  # serial number of the camera
    camera_frame: str  # the optical frame whose pose this is
    T_base_camera: np.ndarray  # in kuka/base_frame, shape (4, 4) [m]
    T_flange_board: np.ndarray  # shape (4, 4) [m]
    rms_mm: float | None  # rms errors of the views; None for LIVE, where no second view contradicts the first
    rms_deg: float | None  # rms errors of the views; None for LIVE, where no second view contradicts the first
    point_sd_mm: float  # standard deviation of a point at the marker board
    errors: np.ndarray  # error of each view [mm, deg], shape (n, 2); shape (0, 2) for LIVE
    views: tuple[CalibrationView, ...]  # the views that it was computed from

    @property
    def accuracy(self) -> str:
        """The accuracy, as a part of a sentence."""
        if self.kind == LIVE:
            return f"one view without confirmation, standard deviation of a point {self.point_sd_mm:.2f} mm"
        return f"{self.rms_mm:.2f} mm, {self.rms_deg:.2f} deg in {len(self.views)} views"


@dataclass(frozen=True)
class _Head:
    date: str = text()
    kind: str = choice(VIEWS, LIVE)
    robot: str = text()
    flange: str = text()
    panel: str = text()
    camera: str = text()
    camera_frame: str = text()
    rms_mm: float | None = number("mm", low=0.0, absent=None)
    rms_deg: float | None = number("deg", low=0.0, absent=None)
    point_sd_mm: float = number("mm", low=0.0)

    def faults(self) -> list[str]:
        """Returns contradictions between fields."""
        if self.kind == VIEWS and None in (self.rms_mm, self.rms_deg):
            return ["rms_mm and rms_deg are missing; a calibration of the kind views needs them."]
        return []


@dataclass(frozen=True)
class _Pose:
    position: np.ndarray = vector(3, "m", low=-10.0, high=10.0)
    quaternion: np.ndarray = vector(4)


@dataclass(frozen=True)
class _View:
    error: np.ndarray | None = vector(2, "mm and deg", low=0.0, absent=None)
    covariance: np.ndarray = vector(36)


HEAD = ("date", "kind", "robot", "flange", "panel", "camera", "camera_frame", "rms_mm", "rms_deg", "point_sd_mm")
POSES = {"T_base_camera": "T_base_camera", "T_flange_panel": "T_flange_board"}
VIEW_POSES = {"T_base_flange": "T_base_flange", "T_camera_panel": "T_camera_board"}
"""The poses: key in the file, attribute of the record."""


def by_views(verdict: Verdict, views: list[CalibrationView], **head: str) -> CalibrationRecord:
    """Returns the record of a calibration by several views.

    Args:
        head: date, robot, flange, panel, camera and camera_frame.
    """
    errors = verdict.result.errors
    norms = (1e3 * np.linalg.norm(errors[:, :3], axis=1), np.degrees(np.linalg.norm(errors[:, 3:], axis=1)))
    return CalibrationRecord(
        kind=VIEWS,
        T_base_camera=verdict.result.T_base_camera,
        T_flange_board=verdict.result.T_flange_board,
        rms_mm=float(verdict.rms[0]),
        rms_deg=float(verdict.rms[1]),
        point_sd_mm=verdict.point_sd_mm,
        errors=read_only(np.stack(norms, 1)),
        views=tuple(views),
        **head,
    )


def mapping_from_record(record: CalibrationRecord) -> dict[str, Any]:
    """Returns the content of the yaml file of a record."""
    values: dict[str, Any] = {key: getattr(record, key) for key in HEAD if getattr(record, key) is not None}
    values.update(_mapping_of_poses(record, POSES))
    values["views"] = [
        {**_mapping_of_poses(view, VIEW_POSES), "covariance": np.ravel(view.covariance).tolist()}
        for view in record.views
    ]
    for entry, error in zip(values["views"], record.errors):
        entry["error"] = error.tolist()
    return values


def record_from_mapping(values: Any) -> CalibrationRecord:
    """Returns the record in the content of a yaml file.

    Raises:
        ConfigError: with all faults.
    """
    faults: list[str] = []
    if not isinstance(values, Mapping):
        raise ConfigError([f"A calibration is a mapping of keys to values, not {type(values).__name__}."])
    head = parse_part(_Head, values, "", faults, (*POSES, "views"))
    poses = _poses(values, "", POSES, faults)
    views, errors = [], []
    entries = values.get("views")
    if not isinstance(entries, list):
        faults.append(f"views is {entries!r}, but must be a list.")
        entries = []
    for i, entry in enumerate(entries):
        view = parse_part(_View, entry, f"views[{i}]/", faults, VIEW_POSES)
        if view is None:
            continue
        view_poses = _poses(entry, f"views[{i}]/", VIEW_POSES, faults)
        if view_poses is not None:
            views.append(CalibrationView(**view_poses, covariance=read_only(view.covariance.reshape(6, 6))))
            if view.error is not None:
                errors.append(view.error)
    if head is not None and head.kind == VIEWS and len(errors) < len(views):
        faults.append("A view has no error; a calibration of the kind views needs one for each.")
    if faults or poses is None:
        raise ConfigError(faults)
    return CalibrationRecord(
        **{key: getattr(head, key) for key in HEAD},
        **poses,
        errors=read_only(np.reshape(errors, (-1, 2))),
        views=tuple(views),
    )


def _mapping_of_poses(source: Any, names: dict[str, str]) -> dict[str, Any]:
    poses = {key: getattr(source, name) for key, name in names.items()}
    return {
        key: {"position": T[:3, 3].tolist(), "quaternion": quaternion_from_rotation(T[:3, :3]).tolist()}
        for key, T in poses.items()
    }


def _poses(values: Mapping, prefix: str, names: dict[str, str], faults: list[str]) -> dict[str, Any] | None:
    """Returns the poses by attribute, or None after adding what is wrong with them to `faults`."""
    poses = {}
    for key, name in names.items():
        where = f"{prefix}{key}/"
        given: Any = values.get(key)
        read = parse_part(_Pose, given, where, faults)
        try:
            if read is not None:
                poses[name] = read_only(pose(rotation_from_quaternion(read.quaternion), read.position))
        except ValueError as error:
            faults.append(f"{where}quaternion: {error}.")
    return poses if len(poses) == len(names) else None
