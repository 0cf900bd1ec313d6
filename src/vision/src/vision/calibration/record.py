"""A stored calibration: its result and accuracy, the hardware it belongs to, and the views to compute it from again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from common.config import choice, number, parse_part, text, vector
from common.errors import ConfigError
from common.frames import frame_name
from common.poses import pose, read_only
from common.rotations import quaternion_from_rotation, rotation_from_quaternion
from common.simulated import SIMULATED, origin, simulated_field
from common.stored_time import moment
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
class RecordHead:
    """The single values of a calibration."""

    date: str = text()  # as `common.stored_time.utc` writes it
    kind: str = choice(VIEWS, LIVE)  # by several views, or by the board's drawing and a single view
    robot: str = text()  # the arm
    flange: str = text()  # its media flange
    panel: str = text(taken_as=frame_name)  # frame of the marker board
    camera: str = text()  # serial number of the camera
    camera_frame: str = text(taken_as=frame_name)  # the optical frame whose pose this is
    rms_mm: float | None = number("mm", low=0.0, absent=None)
    rms_deg: float | None = number("deg", low=0.0, absent=None)  # of the views; None for LIVE, a single view
    point_sd_mm: float = number("mm", low=0.0)  # standard deviation of a point at the marker board
    simulated: bool | None = simulated_field()

    def faults(self) -> list[str]:
        try:
            moment(self.date)
        except ValueError:
            return [f"date is {self.date!r}, but must be as 2026-01-31T12:00:00Z."]
        if self.kind == VIEWS and None in (self.rms_mm, self.rms_deg):
            return ["rms_mm and rms_deg are missing; a calibration of the kind views needs them."]
        return []


@dataclass(frozen=True, eq=False)
class CalibrationRecord(RecordHead):
    """The content of one file. For mypy the fields of the head have defaults."""

    T_base_camera: np.ndarray  # type: ignore[misc]  # in kuka/base_frame, shape (4, 4) [m]
    T_flange_board: np.ndarray  # type: ignore[misc]  # shape (4, 4) [m]
    errors: np.ndarray  # type: ignore[misc]  # error of each view [mm, deg], shape (n, 2); shape (0, 2) for LIVE
    views: tuple[CalibrationView, ...]  # type: ignore[misc]  # the views that it was computed from

    @property
    def accuracy(self) -> str:
        if self.kind == LIVE:
            found = f"one view without confirmation, standard deviation of a point {self.point_sd_mm:.2f} mm"
        else:
            found = f"{self.rms_mm:.2f} mm, {self.rms_deg:.2f} deg in {len(self.views)} views"
        return f"{found}, {origin(self.simulated)}"


@dataclass(frozen=True)
class _Pose:
    position: np.ndarray = vector(3, "m", low=-10.0, high=10.0)
    quaternion: np.ndarray = vector(4)


@dataclass(frozen=True)
class _PoseOnArm(_Pose):
    position: np.ndarray = vector(3, "m", low=-2.0, high=2.0)  # no arm reaches farther


@dataclass(frozen=True)
class _PoseOnFlange(_Pose):
    position: np.ndarray = vector(3, "m", low=-1.0, high=1.0)  # as `MarkerBoardConfig.translation`


@dataclass(frozen=True)
class _View:
    error: np.ndarray | None = vector(2, "mm and deg", low=0.0, absent=None)
    covariance: np.ndarray = vector(36)


POSES = {"T_base_camera": "T_base_camera", "T_flange_panel": "T_flange_board"}
BOUNDS = {"T_base_flange": _PoseOnArm, "T_flange_panel": _PoseOnFlange}
VIEW_POSES = {"T_base_flange": "T_base_flange", "T_camera_panel": "T_camera_board"}  # key in the file: attribute


def by_views(verdict: Verdict, views: list[CalibrationView], **head: Any) -> CalibrationRecord:
    """Returns the record of a calibration by views; `head` has date, robot, flange, panel, camera, camera_frame and
    simulated."""
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
    values = {field.name: getattr(record, field.name) for field in fields(RecordHead)}
    head = {key: value for key, value in values.items() if value is not None}
    views = [
        {**_mapping_of_poses(view, VIEW_POSES), "covariance": np.ravel(view.covariance).tolist()}
        for view in record.views
    ]
    for entry, error in zip(views, record.errors):
        entry["error"] = error.tolist()
    return {**head, **_mapping_of_poses(record, POSES), "views": views}


def record_from_mapping(values: Any) -> CalibrationRecord:
    """Returns the record in the content of a yaml file; raises ConfigError with all faults."""
    faults: list[str] = []
    if not isinstance(values, Mapping):
        raise ConfigError([f"A calibration is a mapping of keys to values, not {type(values).__name__}."])
    head = parse_part(RecordHead, values, "", faults, (*POSES, "views"))
    poses = _poses(values, "", POSES, faults)
    views, errors = [], []
    entries = values.get("views")
    if not isinstance(entries, list):
        faults.append(f"views is {entries!r}, but must be a list.")
        entries = []
    for i, entry in enumerate(entries):
        view = parse_part(_View, entry, f"views[{i}]/", faults, VIEW_POSES)
        view_poses = None if view is None else _poses(entry, f"views[{i}]/", VIEW_POSES, faults)
        if view is not None and view_poses is not None:
            views.append(CalibrationView(**view_poses, covariance=read_only(view.covariance.reshape(6, 6))))
            errors += [] if view.error is None else [view.error]
    if head is not None and head.kind == VIEWS and len(errors) < len(views):
        faults.append("A view has no error; a calibration of the kind views needs one for each.")
    if faults or head is None or poses is None:
        raise ConfigError(faults)
    said = {**vars(head), "simulated": True if head.camera == SIMULATED else head.simulated}
    return CalibrationRecord(**said, **poses, errors=read_only(np.reshape(errors, (-1, 2))), views=tuple(views))


def _mapping_of_poses(source: Any, names: dict[str, str]) -> dict[str, Any]:
    return {
        key: {"position": T[:3, 3].tolist(), "quaternion": quaternion_from_rotation(T[:3, :3]).tolist()}
        for key, T in ((key, getattr(source, name)) for key, name in names.items())
    }


def _poses(values: Mapping, prefix: str, names: dict[str, str], faults: list[str]) -> dict[str, Any] | None:
    """Returns the poses by attribute, or None after adding what is wrong with them to `faults`."""
    poses = {}
    for key, name in names.items():
        given: Any = values.get(key)
        read = parse_part(BOUNDS.get(key, _Pose), given, f"{prefix}{key}/", faults)
        try:
            if read is not None:
                poses[name] = read_only(pose(rotation_from_quaternion(read.quaternion), read.position))
        except ValueError as error:
            faults.append(f"{prefix}{key}/quaternion: {error}.")
    return poses if len(poses) == len(names) else None
