"""The pose of a flat target from its corners in one picture.

The corners are freed from the camera's distortion first. A plane seen in perspective can nearly always be explained by
two poses, tilted to opposite sides of the line of sight (Schweighofer and Pinz 2006; Collins and Bartoli 2014, whose
closed form IPPE gives both). Each is refined until the squares of the reprojection errors are least (Levenberg and
Marquardt). Then the two are weighed: by these errors if they differ clearly, otherwise by what is known from before or
from a depth picture.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import cv2
import numpy as np
import pinocchio as pin

from common.camera_model import CameraModel
from common.poses import pose, read_only
from common.rotations import rotation_angle

CORNER_SIGMA_PX = 0.2
"""Error of a corner that the covariance builds on: on rendered pictures 0.05 to 0.2, mostly bias, no noise."""

CLEAR_RATIO = 2.0
"""From this ratio of the two reprojection errors on there is no doubt about the pose (reference: vision, 6.3)."""

MAX_LOG_ODDS = 500.0
"""Beyond it the exponential overflows; it is certainty already."""

PLANE_TOLERANCE_M = 1e-6
NO_DISTORTION = np.zeros(5)
MAX_STEPS = 40
LAST_GAIN = 1e-12
"""The refinement ends when a step makes the sum of squares less by no greater share than this."""

REPROJECTION, HINT = "reprojection", "hint"


@dataclass(frozen=True, eq=False)
class TagPose:
    """The pose of a target and how sure it is.

    Attributes:
        T_camera_tag: pose in the camera's optical frame, shape (4, 4) [m].
        covariance: of x, y, z and of small turns about the camera's x, y, z axes, shape (6, 6) [m^2, m rad, rad^2];
            as wide as the other pose is far, as long as that may be the true one.
        rms: root mean square distance of the reprojected corners [px].
        ratio: rms of the other pose divided by this one's; infinite if there is no other.
        other: the other pose, or None.
        chosen_by: REPROJECTION or HINT.
    """

    T_camera_tag: np.ndarray
    covariance: np.ndarray
    rms: float
    ratio: float
    other: np.ndarray | None
    chosen_by: str

    @property
    def ambiguous(self) -> bool:
        """Whether the picture alone does not tell the two poses apart."""
        return self.ratio < CLEAR_RATIO


def tag_pose(points: np.ndarray, pixels: np.ndarray, camera: CameraModel, hint: np.ndarray | None = None) -> TagPose:
    """Returns the pose of the target.

    Args:
        points: corners in the target, shape (n, 3) [m], n >= 4.
        pixels: where they are in the picture, shape (n, 2) [px].
        camera: that took the picture.
        hint: rotation from the camera to the target, shape (3, 3), as a moment before or from a depth picture; decides
            between two poses that explain the picture about equally well.

    Raises:
        ValueError: there are fewer than four corners, or no pose has them all in front of the camera.
    """
    points, pixels = np.asarray(points, dtype=float), np.asarray(pixels, dtype=float)
    if len(points) < 4:
        raise ValueError(f"a pose needs four corners at least, not {len(points)}")
    ideal = camera.rays(pixels)[:, :2] * (camera.K[0, 0], camera.K[1, 1]) + camera.K[:2, 2]
    ends = [_refined(points, ideal, camera.K, rvec, tvec) for rvec, tvec in _starts(points, ideal, camera.K)]
    candidates = sorted((end for end in ends if end is not None), key=lambda c: c[1])
    if not candidates:
        raise ValueError(f"no pose has the corners {pixels.round(1).tolist()} in front of the camera")
    candidates = [candidates[0], *(c for c in candidates[1:] if _different(c[0], candidates[0][0]))][:2]
    chosen_by = REPROJECTION
    if len(candidates) == 2 and hint is not None and candidates[1][1] < CLEAR_RATIO * candidates[0][1]:
        candidates.sort(key=lambda c: rotation_angle(hint.T @ c[0][:3, :3]))
        chosen_by = HINT
    T, rms = candidates[0]
    other = candidates[1] if len(candidates) == 2 else None
    spread = covariance(T, points, camera.K)
    if other is not None:
        spread = spread + _doubt(T, rms, *other, len(points))
    return TagPose(
        read_only(T),
        read_only(spread),
        rms,
        np.inf if other is None else float(other[1] / max(rms, 1e-9)),
        None if other is None else read_only(other[0]),
        chosen_by,
    )


def _doubt(T: np.ndarray, rms: float, other: np.ndarray, other_rms: float, corners: int) -> np.ndarray:
    """Returns what the possibility that the `other` pose is the true one adds to the covariance of T, shape (6, 6).

    The chance of that follows from both reprojection errors [px] by the corners alone, also where a hint has chosen.
    """
    gap = 0.5 * corners * (other_rms**2 - rms**2) / CORNER_SIGMA_PX**2
    change = np.concatenate((other[:3, 3] - T[:3, 3], pin.log3(other[:3, :3] @ T[:3, :3].T)))
    return np.outer(change, change) / (1.0 + np.exp(np.clip(gap, -MAX_LOG_ODDS, MAX_LOG_ODDS)))


def covariance(T: np.ndarray, points: np.ndarray, K: np.ndarray, sigma: float = CORNER_SIGMA_PX) -> np.ndarray:
    """Returns the covariance, shape (6, 6), of a pose from corners with independent errors.

    Args:
        T: pose of the target in the camera, shape (4, 4) [m].
        points: corners in the target, shape (n, 3) [m].
        K: camera matrix, shape (3, 3) [px].
        sigma: standard deviation of each coordinate of a corner [px].
    """
    J = corner_jacobian(T, points, K).reshape(-1, 6)
    return sigma**2 * np.linalg.inv(J.T @ J)


def corner_jacobian(T: np.ndarray, points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Returns how the undistorted pixels of `points` move, shape (n, 2, 6), with the pose T of the target.

    Columns: shift of the target along, then small turns about axes through its origin parallel to, the camera's x, y, z
    [px/m, px/rad].
    """
    turned = points @ T[:3, :3].T
    x, y, z = (turned + T[:3, 3]).T
    J_pixel = np.zeros((len(points), 2, 3))
    J_pixel[:, 0, 0], J_pixel[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    J_pixel[:, 1, 1], J_pixel[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    J_turn = np.zeros((len(points), 3, 3))
    J_turn[:, (2, 0, 1), (1, 2, 0)] = -turned  # the cross products with the axes, written out: numpy's are slow
    J_turn[:, (1, 2, 0), (2, 0, 1)] = turned
    return np.concatenate((J_pixel, J_pixel @ J_turn), axis=2)


def _starts(points: np.ndarray, ideal: np.ndarray, K: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns rough poses; for a plane that faces the camera OpenCV's IPPE gives turns that are far off, or no numbers,
    so that the closed form for any points (SQPnP) stands beside it."""
    flat = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < PLANE_TOLERANCE_M
    starts = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP) if flat else (cv2.SOLVEPNP_SQPNP,):
        with contextlib.suppress(cv2.error):
            found, rvecs, tvecs, _ = cv2.solvePnPGeneric(points, ideal, K, NO_DISTORTION, flags=method)
            starts += list(zip(rvecs, tvecs)) if found else []
    return starts


def _refined(
    points: np.ndarray, ideal: np.ndarray, K: np.ndarray, rvec: np.ndarray, tvec: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Returns the pose with the least squares and its rms [px], or None if a corner is not in front of the camera."""
    T, damping = pose(cv2.Rodrigues(rvec)[0], tvec.ravel()), 1e-6
    residual = _residual(T, points, ideal, K)
    if residual is None:
        return None
    for _ in range(MAX_STEPS):
        J = corner_jacobian(T, points, K).reshape(-1, 6)
        H = J.T @ J
        step = np.linalg.solve(H + damping * np.diag(np.diag(H)), -J.T @ residual)
        moved = pose(pin.exp3(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
        after = _residual(moved, points, ideal, K)
        if after is None or after @ after > residual @ residual:
            damping *= 10.0
            continue
        gain = residual @ residual - after @ after
        done = gain <= LAST_GAIN * (residual @ residual)
        T, residual, damping = moved, after, damping / 10.0
        if done:
            break
    return T, float(np.sqrt(residual @ residual / len(points)))


def _residual(T: np.ndarray, points: np.ndarray, ideal: np.ndarray, K: np.ndarray) -> np.ndarray | None:
    seen = points @ T[:3, :3].T + T[:3, 3]
    if not np.all(np.isfinite(seen)) or np.any(seen[:, 2] <= 0.0):
        return None
    return (seen[:, :2] / seen[:, 2:] * (K[0, 0], K[1, 1]) + K[:2, 2] - ideal).ravel()


def _different(T: np.ndarray, other: np.ndarray) -> bool:
    return rotation_angle(T[:3, :3].T @ other[:3, :3]) > np.radians(0.5)
