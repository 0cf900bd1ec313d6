"""Estimates the pose of a flat target from its corners in one image. The camera's distortion is removed from the
corners first. Two poses, tilted to opposite sides of the line of sight, explain most perspective images of a plane
(Schweighofer and Pinz 2006; Collins and Bartoli 2014, whose closed form IPPE returns both). Each is refined to the
smallest sum of squared reprojection errors (Levenberg-Marquardt). If these errors differ clearly, the smaller one
decides; otherwise a known orientation does, from an earlier or from a depth image."""

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
"""Standard deviation of a corner that the covariance assumes; rendered images have 0.05 to 0.2, mostly bias."""
CLEAR_RATIO = 2.0
"""A ratio of the two reprojection errors above this counts as unambiguous."""
NO_DISTORTION = np.zeros(5)
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 40, 1e-12)
SAME_RAD = np.radians(0.5)
"""Poses that differ by less are the same solution."""
REPROJECTION, HINT = "reprojection", "hint"


@dataclass(frozen=True, eq=False)
class TagPose:
    """The pose of a target and its uncertainty."""

    T_camera_tag: np.ndarray  # pose in the camera's optical frame, shape (4, 4) [m]
    covariance: np.ndarray  # of x, y, z and small rotations about the camera's axes, shape (6, 6) [m^2, m rad, rad^2]
    """Reaches to the other pose while that may be the true one."""
    rms: float  # rms distance of the reprojected corners [px]
    ratio: float  # rms of the other pose divided by this one's; infinite without another
    other: np.ndarray | None  # the other pose
    chosen_by: str  # REPROJECTION or HINT

    @property
    def ambiguous(self) -> bool:
        """Whether the image alone cannot decide between the two poses."""
        return self.ratio < CLEAR_RATIO


def tag_pose(points: np.ndarray, pixels: np.ndarray, camera: CameraModel, hint: np.ndarray | None = None) -> TagPose:
    """Returns the pose of the target with at least four corners `points`, shape (n, 3) [m], at `pixels`, shape (n, 2)
    [px]. The hint is a known rotation from the camera to the target, shape (3, 3), from an earlier or a depth image; it
    decides between two poses that explain the image about equally well. Raises ValueError if there are fewer than four
    corners, or no pose has them all in front of the camera."""
    points, pixels = np.asarray(points, dtype=float), np.asarray(pixels, dtype=float)
    if len(points) < 4:
        raise ValueError(f"a pose needs at least four corners, not {len(points)}")
    ideal = camera.rays(pixels)[:, :2] * (camera.K[0, 0], camera.K[1, 1]) + camera.K[:2, 2]
    ends = [_refined(points, ideal, camera.K, rvec, tvec) for rvec, tvec in _starts(points, ideal, camera.K)]
    candidates = sorted((end for end in ends if end is not None), key=lambda c: c[1])
    if not candidates:
        raise ValueError(
            f"no pose in front of the camera has the corners {pixels.round(1).tolist()}: show the whole tag"
        )
    best = candidates[0][0]
    others = [c for c in candidates[1:] if rotation_angle(c[0][:3, :3].T @ best[:3, :3]) > SAME_RAD]
    candidates = [candidates[0], *others[:1]]
    chosen_by = REPROJECTION
    if len(candidates) == 2 and hint is not None and candidates[1][1] < CLEAR_RATIO * candidates[0][1]:
        candidates.sort(key=lambda c: rotation_angle(hint.T @ c[0][:3, :3]))
        chosen_by = HINT
    T, rms = candidates[0]
    other = candidates[1] if len(candidates) == 2 else None
    uncertainty = covariance(T, points, camera.K)
    if other is not None:
        uncertainty = uncertainty + _ambiguity(T, rms, *other, len(points))
    return TagPose(
        read_only(T),
        read_only(uncertainty),
        rms,
        np.inf if other is None else float(other[1] / max(rms, 1e-9)),
        None if other is None else read_only(other[0]),
        chosen_by,
    )


def _ambiguity(T: np.ndarray, rms: float, other: np.ndarray, other_rms: float, corners: int) -> np.ndarray:
    """Returns the covariance that the possible truth of the `other` pose adds to that of T, shape (6, 6). Its
    probability follows from both reprojection errors [px], even where a hint decided."""
    # Above this the exponential overflows, and the pose is certain anyway.
    max_log_odds = 500.0
    gap = 0.5 * corners * (other_rms**2 - rms**2) / CORNER_SIGMA_PX**2
    change = np.concatenate((other[:3, 3] - T[:3, 3], pin.log3(other[:3, :3] @ T[:3, :3].T)))
    return np.outer(change, change) / (1.0 + np.exp(np.clip(gap, -max_log_odds, max_log_odds)))


def covariance(T: np.ndarray, points: np.ndarray, K: np.ndarray, sigma: float = CORNER_SIGMA_PX) -> np.ndarray:
    """Returns the covariance, shape (6, 6), of the pose T, shape (4, 4) [m], from corners in the target, shape (n, 3)
    [m], with the camera matrix K and independent errors with the standard deviation `sigma` in each coordinate [px]."""
    J = corner_jacobian(T, points, K).reshape(-1, 6)
    return sigma**2 * np.linalg.inv(J.T @ J)


def corner_jacobian(T: np.ndarray, points: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Returns the derivative of the undistorted pixels of `points` by the pose T of the target, shape (n, 2, 6).
    Columns: translation along the camera's x, y, z [px/m], then small rotations about axes through the target's origin
    parallel to them [px/rad]."""
    turned = points @ T[:3, :3].T
    x, y, z = (turned + T[:3, 3]).T
    J_pixel = np.zeros((len(points), 2, 3))
    J_pixel[:, 0, 0], J_pixel[:, 0, 2] = K[0, 0] / z, -K[0, 0] * x / z**2
    J_pixel[:, 1, 1], J_pixel[:, 1, 2] = K[1, 1] / z, -K[1, 1] * y / z**2
    J_turn = np.zeros((len(points), 3, 3))
    J_turn[:, (2, 0, 1), (1, 2, 0)] = -turned  # cross products with the axes; np.cross is slow
    J_turn[:, (1, 2, 0), (2, 0, 1)] = turned
    return np.concatenate((J_pixel, J_pixel @ J_turn), axis=2)


def _starts(points: np.ndarray, ideal: np.ndarray, K: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns rough poses. For a plane that faces the camera OpenCV's IPPE can return wrong rotations or NaN, so the
    closed form for any points (SQPnP) is tried too."""
    plane_tolerance_m = 1e-6
    flat = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2] < plane_tolerance_m
    starts = []
    for method in (cv2.SOLVEPNP_IPPE, cv2.SOLVEPNP_SQPNP) if flat else (cv2.SOLVEPNP_SQPNP,):
        with contextlib.suppress(cv2.error):
            found, rvecs, tvecs, _ = cv2.solvePnPGeneric(points, ideal, K, NO_DISTORTION, flags=method)
            starts += list(zip(rvecs, tvecs)) if found else []
    return starts


def _refined(
    points: np.ndarray, ideal: np.ndarray, K: np.ndarray, rvec: np.ndarray, tvec: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """Returns the pose with the smallest reprojection error and its rms [px]; None if it is behind the camera."""
    if not _in_front(points, rvec, tvec):
        return None
    rvec, tvec = cv2.solvePnPRefineLM(points, ideal, K, NO_DISTORTION, rvec, tvec, CRITERIA)
    if not _in_front(points, rvec, tvec):
        return None
    residual = cv2.projectPoints(points, rvec, tvec, K, NO_DISTORTION)[0][:, 0] - ideal
    return pose(cv2.Rodrigues(rvec)[0], tvec.ravel()), float(np.sqrt(np.sum(residual**2) / len(points)))


def _in_front(points: np.ndarray, rvec: np.ndarray, tvec: np.ndarray) -> bool:
    z = points @ cv2.Rodrigues(rvec)[0][2] + tvec.ravel()[2]
    return bool(np.all(z > 0.0) and np.all(np.isfinite(tvec)))
