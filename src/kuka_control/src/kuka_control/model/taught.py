"""A motion that was taught by hand, as a file keeps it: the joints of its way points, and of which arm they are."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from common.errors import RigError
from common.poses import read_only
from iiwa_kinematics import RobotModel
from kuka_control.model.joint_configurations import range_faults

FORMAT = "leap_rig taught motion"
VERSION = 1
MOST_POINTS = 10_000
SAME_RAD = math.radians(0.5)  # way points that are nearer to each other are one
PATH_RAD = math.radians(1.0)  # no joint of a recorded path is farther from the way points that are kept of it


class TaughtArm(NamedTuple):
    """The arm that was taught: its robot and media flange, and its namespace beside others, or nothing."""

    robot: str
    flange: str
    name: str


def content_of(points: np.ndarray, arm: TaughtArm) -> dict[str, Any]:
    """Returns what is written of way points, shape (n, 7) [rad]; their count stands last: a torn file lacks it."""
    return {"format": FORMAT, "version": VERSION, **arm._asdict(), "points": points.tolist(), "count": len(points)}


def points_of(content: object, arm: TaughtArm, model: RobotModel) -> np.ndarray:
    """Returns the way points in the content of a file, shape (n, 7) [rad]; RigError: it is not one, or of another
    arm. The message continues "NAME is refused: "."""
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise RigError("it is no taught motion.")
    if content.get("version") != VERSION:
        raise RigError(f"its version is {content.get('version')!r}, but this program reads {VERSION}.")
    for key, here in arm._asdict().items():
        if content.get(key) != here:
            raise RigError(f"it was taught to {key} {content.get(key)!r}, but this arm has {here!r}.")
    points = content.get("points")
    if not isinstance(points, list) or not 0 < len(points) <= MOST_POINTS or content.get("count") != len(points):
        raise RigError(f"it is torn: the count behind its way points is {content.get('count')!r}.")
    for number, point in enumerate(points, 1):
        numbers = isinstance(point, list) and all(type(angle) in (int, float) for angle in point)
        if not numbers or len(point) != 7 or not all(map(math.isfinite, point)):
            raise RigError(f"way point {number} is {point!r}, but must be seven finite angles in rad.")
        faults = range_faults(model, np.array(point, dtype=float))
        if faults:
            raise RigError(f"way point {number}: {faults[0]}")
    return read_only(np.array(points, dtype=float))


def reduced(path: np.ndarray, tolerance: float = PATH_RAD) -> np.ndarray:
    """Returns the points of a path, shape (n, 7) [rad], between which all others lie on straight lines in joint space,
    within a tolerance [rad]; the first and the last are among them. Source: Douglas and Peucker, Algorithms for the
    reduction of the number of points required to represent a digitized line, 1973."""
    kept, open_spans = {0, len(path) - 1}, [(0, len(path) - 1)]
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        span, inner = path[last] - path[first], path[first + 1 : last] - path[first]
        along = np.clip(inner @ span / max(float(span @ span), 1e-12), 0.0, 1.0)
        off = np.max(np.abs(inner - along[:, None] * span), axis=1)
        k = first + 1 + int(np.argmax(off))
        if off[k - first - 1] > tolerance:
            kept.add(k)
            open_spans += [(first, k), (k, last)]
    return path[sorted(kept)]
