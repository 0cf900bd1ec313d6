"""A stored calibration: what was found, with what, how well, and the views that it can be computed from again."""

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
from vision.calibration.hand_eye import View

VIEWS, LIVE = "views", "live"


@dataclass(frozen=True, eq=False)
class CalibrationRecord:
    """What one file holds.

    Attributes:
        date: when, as year-month-dayThour:minute:second.
        kind: VIEWS for a calibration by several views, LIVE for one by the panel's drawing and a single view.
        robot, flange: the arm and the media flange.
        panel: the panel's frame.
        camera: serial number of the camera.
        camera_frame: the optical frame whose pose this is.
        T_base_camera: in kuka/base_frame, shape (4, 4) [m].
        T_flange_panel: shape (4, 4) [m].
        rms_mm, rms_deg: root mean square error of the views; None for LIVE, where nothing contradicts the one view.
        point_sd_mm: standard deviation of a point at the panel.
        errors: each view's error [mm, deg], shape (n, 2); shape (0, 2) for LIVE.
        views: what it was computed from.
    """

    date: str
    kind: str
    robot: str
    flange: str
    panel: str
    camera: str
    camera_frame: str
    T_base_camera: np.ndarray
    T_flange_panel: np.ndarray
    rms_mm: float | None
    rms_deg: float | None
    point_sd_mm: float
    errors: np.ndarray
    views: tuple[View, ...]

    @property
    def accuracy(self) -> str:
        """How well the place is known, as a part of a sentence."""
        if self.kind == LIVE:
            return f"one view, which nothing confirms; a point at the panel known to {self.point_sd_mm:.2f} mm"
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
        """Returns what no single field can check."""
        if self.kind == VIEWS and None in (self.rms_mm, self.rms_deg):
            return ["rms_mm and rms_deg are missing, which several views have."]
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
VIEW_POSES = ("T_base_flange", "T_camera_panel")
POSES = {"T_base_camera": "camera in kuka/base_frame", "T_flange_panel": "panel in the flange"}


def by_views(verdict: Verdict, views: list[View], **head: str) -> CalibrationRecord:
    """Returns the record of a calibration by several views.

    Args:
        head: date, robot, flange, panel, camera and camera_frame.
    """
    errors = verdict.result.errors
    norms = np.stack(
        (1e3 * np.linalg.norm(errors[:, :3], axis=1), np.degrees(np.linalg.norm(errors[:, 3:], axis=1))), 1
    )
    return CalibrationRecord(
        kind=VIEWS,
        T_base_camera=verdict.result.T_base_camera,
        T_flange_panel=verdict.result.T_flange_panel,
        rms_mm=float(verdict.rms[0]),
        rms_deg=float(verdict.rms[1]),
        point_sd_mm=verdict.point_sd_mm,
        errors=read_only(norms),
        views=tuple(views),
        **head,
    )


def mapping_from_record(record: CalibrationRecord) -> dict[str, Any]:
    """Returns what the yaml file of a record holds."""
    values: dict[str, Any] = {key: getattr(record, key) for key in HEAD if getattr(record, key) is not None}
    values.update({key: _mapping_from_pose(getattr(record, key)) for key in POSES})
    values["views"] = [
        {
            "T_base_flange": _mapping_from_pose(view.T_base_flange),
            "T_camera_panel": _mapping_from_pose(view.T_camera_panel),
            "covariance": np.ravel(view.covariance).tolist(),
        }
        for view in record.views
    ]
    for entry, error in zip(values["views"], record.errors):
        entry["error"] = error.tolist()
    return values


def record_from_mapping(values: Any) -> CalibrationRecord:
    """Returns the record that a yaml file holds.

    Raises:
        ConfigError: with all faults.
    """
    faults: list[str] = []
    if not isinstance(values, Mapping):
        raise ConfigError([f"A calibration is a mapping of keys to values, not {type(values).__name__}."])
    head = parse_part(_Head, values, "", faults, (*POSES, "views"))
    T_base_camera, T_flange_panel = (_pose(values.get(key), f"{key}/", faults) for key in POSES)
    views, errors = [], []
    entries = values.get("views")
    if not isinstance(entries, list):
        faults.append(f"views is {entries!r}, but must be a list.")
        entries = []
    for i, entry in enumerate(entries):
        where = f"views[{i}]/"
        view = parse_part(_View, entry, where, faults, VIEW_POSES)
        if view is None:
            continue
        T_base_flange, T_camera_panel = (_pose(entry.get(key), f"{where}{key}/", faults) for key in VIEW_POSES)
        if T_base_flange is not None and T_camera_panel is not None:
            views.append(View(T_base_flange, T_camera_panel, read_only(view.covariance.reshape(6, 6))))
            if view.error is not None:
                errors.append(view.error)
    if head is not None and head.kind == VIEWS and len(errors) < len(views):
        faults.append("The error of a view is missing.")
    if faults or T_base_camera is None or T_flange_panel is None:
        raise ConfigError(faults)
    return CalibrationRecord(
        **{key: getattr(head, key) for key in HEAD},
        T_base_camera=T_base_camera,
        T_flange_panel=T_flange_panel,
        errors=read_only(np.reshape(errors, (-1, 2))),
        views=tuple(views),
    )


def _mapping_from_pose(T: np.ndarray) -> dict[str, list[float]]:
    return {"position": T[:3, 3].tolist(), "quaternion": quaternion_from_rotation(T[:3, :3]).tolist()}


def _pose(values: Any, where: str, faults: list[str]) -> np.ndarray | None:
    read = parse_part(_Pose, values, where, faults)
    if read is None:
        return None
    try:
        return read_only(pose(rotation_from_quaternion(read.quaternion), read.position))
    except ValueError as error:
        faults.append(f"{where}quaternion: {error}.")
        return None
