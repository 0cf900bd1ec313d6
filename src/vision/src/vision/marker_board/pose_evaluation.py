"""How far the poses of the panel are from the truth, by distance and tilt, as tables.

Three errors are told: of the panel's centre, of its turn, and of a point REACH_M away from it, where something is to be
grasped: whoever places the camera by the panel makes that error there (root mean square over all directions).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.rotations import rotation_angle
from vision.marker_board.plane_pose import DepthPose, Estimate

METHODS = ("colour", "plane", "fused")
REACH_M = 0.5
CSV_HEAD = (
    "variant,distance_m,tilt_deg,method,pictures,found,position_mm_median,position_mm_95,rotation_deg_median,"
    "rotation_deg_95,reach_mm_median,reach_mm_95,normalised_square_mean"
)


@dataclass(frozen=True)
class Errors:
    """Of one pose.

    Attributes:
        position: of the centre [mm].
        rotation: [deg].
        reach: of a point REACH_M away [mm].
        square: squared error in its own covariance, over its 6 degrees of freedom; 1 on average if that is honest.
    """

    position: float
    rotation: float
    reach: float
    square: float


@dataclass(frozen=True)
class Trial:
    """One pair of pictures.

    Attributes:
        distance: of the panel [m].
        tilt: between its normal and the line of sight [deg].
        errors: by method; a method without a pose is missing.
    """

    distance: float
    tilt: float
    errors: dict[str, Errors]


def trial(distance: float, tilt: float, T_truth: np.ndarray, poses: DepthPose | None) -> Trial:
    """Returns the errors of the poses found in a pair of pictures; None: no tag was seen.

    Args:
        T_truth: pose of the panel in the colour camera, shape (4, 4) [m].
    """
    found = {} if poses is None else {name: getattr(poses, name) for name in METHODS}
    return Trial(distance, tilt, {name: errors_of(T_truth, e) for name, e in found.items() if e is not None})


def cells(trials: list[Trial]) -> list[tuple[float, float]]:
    """Returns the distances and tilts that occur, in order."""
    return sorted({(t.distance, t.tilt) for t in trials})


def values(
    trials: list[Trial], method: str, quantity: str, distance: float | None = None, tilt: float | None = None
) -> np.ndarray:
    """Returns a quantity of Errors for all trials with a pose, of one distance and one tilt if these are given."""
    return np.array(
        [
            getattr(t.errors[method], quantity)
            for t in trials
            if method in t.errors and distance in (None, t.distance) and tilt in (None, t.tilt)
        ]
    )


def markdown(trials: list[Trial], methods: tuple[str, ...] = METHODS) -> list[str]:
    """Returns a table: for each distance and tilt, and for each method, the median | 95 % of position, turn, reach."""
    titles = [f"{method} {unit}" for method in methods for unit in ("mm", "deg", f"mm at {REACH_M:g} m")]
    lines = ["| distance, tilt | " + " | ".join(titles) + " |", "|" + "---|" * (len(titles) + 1)]
    for distance, tilt in [*cells(trials), (None, None)]:
        name = "all" if distance is None else f"{distance:g} m, {tilt:g} deg"
        texts = []
        for method in methods:
            for quantity, digits in (("position", 1), ("rotation", 2), ("reach", 1)):
                found = values(trials, method, quantity, distance, tilt)
                texts.append(
                    f"{np.median(found):.{digits}f} / {np.percentile(found, 95):.{digits}f}" if found.size else "-"
                )
        lines.append(f"| {name} | " + " | ".join(texts) + " |")
    return lines


def csv(variant: str, trials: list[Trial]) -> list[str]:
    """Returns a line for each distance, tilt and method, with the columns of CSV_HEAD."""
    lines = []
    for distance, tilt in cells(trials):
        count = sum((t.distance, t.tilt) == (distance, tilt) for t in trials)
        for method in METHODS:
            columns = [variant, f"{distance:g}", f"{tilt:g}", method, str(count)]
            for quantity in ("position", "rotation", "reach"):
                found = values(trials, method, quantity, distance, tilt)
                if quantity == "position":
                    columns.append(str(found.size))
                columns += [f"{np.median(found):.4f}", f"{np.percentile(found, 95):.4f}"] if found.size else ["", ""]
            squares = values(trials, method, "square", distance, tilt)
            columns.append(f"{squares.mean():.3f}" if squares.size else "")
            lines.append(",".join(columns))
    return lines


def errors_of(T: np.ndarray, estimate: Estimate) -> Errors:
    """Returns the errors of an estimate where the truth is T, shape (4, 4) [m]."""
    seen = estimate.T_camera_panel
    shift = seen[:3, 3] - T[:3, 3]
    turn = pin.log3(seen[:3, :3] @ T[:3, :3].T)
    angle = rotation_angle(seen[:3, :3] @ T[:3, :3].T)
    both = np.concatenate((shift, turn))
    reach = np.sqrt(shift @ shift + 2.0 / 3.0 * (REACH_M * angle) ** 2)
    square = both @ np.linalg.solve(estimate.covariance, both) / 6.0
    return Errors(1e3 * float(np.linalg.norm(shift)), float(np.degrees(angle)), 1e3 * float(reach), float(square))
