"""The pose of the marker board from its tag corners and its plane in the depth image. Three poses are estimated.

Colour-only: least squares over the corners (`apriltag_ros.tag_pose`); inaccurate in range, and in tilt where the board
faces the camera. Plane: the corners' rays end on the plane, so tilt and range come from depth. Fused: the least squares
over corners and plane, each weighted by its covariance. A weighted mean of the first two would count the corners twice;
the least squares count each measurement once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from apriltag_ros.detector import TagDetector, TargetDetection
from apriltag_ros.settings import DetectorSettings, TagTarget
from apriltag_ros.tag_pose import corner_jacobian
from common.camera_model import CameraModel
from common.poses import inverse, pose, read_only
from common.rotations import rotation_about, unit
from vision.marker_board.plane_fit import PlaneFit, PlanePoseConfig, fit_board, plane_seen_from

FLAT_M = 1e-6


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """A pose and its uncertainty."""

    T_camera_board: np.ndarray  # shape (4, 4) [m]
    covariance: np.ndarray  # of x, y, z and rotations about the camera's axes, shape (6, 6) [m^2, m rad, rad^2]


@dataclass(frozen=True, eq=False)
class RgbdPose:
    """The marker board in a pair of images."""

    colour: PoseEstimate  # pose by the corners alone; its covariance includes the camera's own errors
    plane: PoseEstimate | None  # pose with tilt and range by depth, or None
    fused: PoseEstimate | None  # pose by both, or None
    fit: PlaneFit  # the plane in the depth camera's frame
    disagreement: float  # range by colour minus range by depth [m]; nan without a plane
    reason: str  # why there is no fused pose, without a full stop; empty if there is one


@dataclass(frozen=True, eq=False)
class RgbdDetection:
    """The marker board in a pair of images: the detector's result, and its poses with depth."""

    colour: TargetDetection
    depth: RgbdPose


class RgbdDetector:
    """Detects one flat marker board on a square plate with the edge `plate` [m] round the origin of its tags. Raises
    ValueError if the tags do not lie in the plane of the plate."""

    def __init__(self, settings: DetectorSettings, target: TagTarget, plate: float, config: PlanePoseConfig) -> None:
        if np.any(np.abs(target.corners[:, 2]) > 1e-6):
            raise ValueError(f"the tags of {target.name} do not lie in the plate, z = 0: correct tags.yaml")
        self._detector = TagDetector(settings, (target,))
        self._rectified = settings.rectified
        self._plate, self._config = plate, config

    def detect(
        self,
        grey: np.ndarray,
        rgb: CameraModel,
        depth_image: np.ndarray,
        depth: CameraModel,
        T_rgb_depth: np.ndarray,
        now: float,
    ) -> RgbdDetection | None:
        """Returns the marker board, or None if no tag is visible or the corners fit no pose. Raises ValueError for an
        image of
        another size than its camera's. `grey`: colour image, shape (height, width), uint8; `now`: stamp [s]."""
        result = self._detector.detect(grey, rgb, now)
        if not result.targets:
            return None
        detection = result.targets[0]
        _, points, pixels = detection.target.matched({tag.id: tag.corners for tag in result.tags})
        camera = rgb.rectified() if self._rectified else rgb
        T = detection.pose.T_camera_tag
        poses = rgbd_pose(T, points, pixels, camera, depth_image, depth, T_rgb_depth, self._plate, self._config)
        return RgbdDetection(detection, poses)


def rgbd_pose(
    T_rgb_board: np.ndarray,
    points: np.ndarray,
    pixels: np.ndarray,
    rgb: CameraModel,
    depth_image: np.ndarray,
    depth: CameraModel,
    T_rgb_depth: np.ndarray,
    plate: float,
    config: PlanePoseConfig,
) -> RgbdPose:
    """Returns the poses of the marker board from one colour and one depth image. Raises ValueError if the depth image
    does not have its camera's size, or the corners do not lie in the plate, whose edge is `plate` [m]. `T_rgb_board`:
    colour-only pose, shape (4, 4) [m]; `points`: corners of the tags on the board, shape (n, 3) [m]; `pixels`: the same
    in the colour image, shape (n, 2) [px]; `depth_image`: raw, shape (height, width), float32 [m], NaN where unknown;
    `T_rgb_depth`: pose of the depth camera in the colour camera, shape (4, 4) [m]."""
    if np.abs(points[:, 2]).max() > FLAT_M:
        raise ValueError("the corners do not lie in the plane of the plate, z = 0: correct tags.yaml")
    rays = rgb.rays(pixels)
    noise = corner_noise(rays, rgb.K, config)
    colour = colour_estimate(T_rgb_board, points, rgb.K, noise)
    fit = fit_board(depth_image, depth, inverse(T_rgb_depth) @ T_rgb_board, plate, config)
    if fit.a is None or fit.covariance is None:
        return RgbdPose(colour, None, None, fit, np.nan, fit.reason)
    a, a_covariance = plane_seen_from(T_rgb_depth, fit.a, fit.covariance)
    plane = plane_estimate(points, rays, rgb.K, noise, a, a_covariance)
    apart, sd = range_disagreement(colour, a, a_covariance)
    if abs(apart) > config.max_disagreement * sd:
        ratio = T_rgb_board[2, 3] / (T_rgb_board[2, 3] - apart)
        reason = (
            f"the distance by the tag size is {ratio:.2f} times that by depth, {abs(apart) / sd:.1f} standard "
            "deviations apart: measure the printed tags, and calibrate the cameras"
        )
        return RgbdPose(colour, plane, None, fit, apart, reason)
    fused = fuse(plane.T_camera_board, points, rays, rgb.K, noise, a, a_covariance)
    return RgbdPose(colour, plane, fused, fit, apart, "" if fused is not None else "the fusion did not converge")


def corner_noise(rays: np.ndarray, K: np.ndarray, config: PlanePoseConfig) -> np.ndarray:
    """Returns the covariance of the corners' pixels, shape (2n, 2n) [px^2]: independent errors, and a focal length
    error, which moves all corners away from the image centre together."""
    outwards = (rays[:, :2] * (K[0, 0], K[1, 1])).ravel()
    return config.corner_sd**2 * np.eye(len(outwards)) + config.focal_sd**2 * np.outer(outwards, outwards)


def colour_estimate(T: np.ndarray, points: np.ndarray, K: np.ndarray, noise: np.ndarray) -> PoseEstimate:
    """Returns the colour-only pose T, shape (4, 4) [m], with its covariance from the corners' `noise`."""
    J = corner_jacobian(T, points, K).reshape(-1, 6)
    gain = np.linalg.solve(J.T @ J, J.T)
    return PoseEstimate(read_only(T), read_only(gain @ noise @ gain.T))


def range_disagreement(colour: PoseEstimate, a: np.ndarray, covariance: np.ndarray) -> tuple[float, float]:
    """Returns the range by colour minus that by the plane a, shape (3,) [1/m], along the line of sight, and the
    standard deviation of the difference [m]."""
    p = colour.T_camera_board[:3, 3]
    z = p[2] / (a @ p)
    sd_plane = z * np.sqrt(p @ covariance @ p) / (a @ p)
    return float(p[2] - z), float(np.hypot(sd_plane, np.sqrt(colour.covariance[2, 2])))


def plane_estimate(
    points: np.ndarray, rays: np.ndarray, K: np.ndarray, noise: np.ndarray, a: np.ndarray, covariance: np.ndarray
) -> PoseEstimate:
    """Returns the pose with tilt and range of the plane, and the corners where their rays meet it. `points`: corners on
    the board, shape (n, 3) [m]; `rays`: theirs, x, y, 1, shape (n, 3); `K`: of the colour camera, shape (3, 3) [px];
    `noise`: covariance of the pixels, shape (2n, 2n) [px^2]; `a, covariance`: the plane in the colour camera's frame,
    shape (3,) [1/m], and (3, 3) [1/m^2]."""
    difference = 1e-6  # step of numeric derivatives [1/m, and of the rays' tangents]
    T = _pose_on_plane(points, rays, a)
    by_plane = [_change(T, _pose_on_plane(points, rays, a + step)) for step in difference * np.eye(3)]
    by_corner = []
    for i in range(len(rays)):
        for axis in range(2):
            moved = rays.copy()
            moved[i, axis] += difference
            by_corner.append(_change(T, _pose_on_plane(points, moved, a)) / K[axis, axis])
    J_plane, J_corner = np.array(by_plane).T / difference, np.array(by_corner).T / difference
    return PoseEstimate(read_only(T), read_only(J_plane @ covariance @ J_plane.T + J_corner @ noise @ J_corner.T))


def fuse(
    start: np.ndarray,
    points: np.ndarray,
    rays: np.ndarray,
    K: np.ndarray,
    noise: np.ndarray,
    a: np.ndarray,
    covariance: np.ndarray,
) -> PoseEstimate | None:
    """Returns the pose that fits corners and plane best by their covariances (Gauss-Newton), or None if the search does
    not converge. It starts from the plane's pose, shape (4, 4) [m], which decides between the corners' two solutions;
    the rest is as for `plane_estimate`."""
    max_steps = 30
    last_step = 1e-8  # the search stops when a step moves the pose by less [m, rad]
    T, W_corner, W_plane = start, np.linalg.inv(noise), np.linalg.inv(covariance)
    for _ in range(max_steps):
        seen = points @ T[:3, :3].T + T[:3, 3]
        r_corner = ((seen[:, :2] / seen[:, 2:] - rays[:, :2]) * (K[0, 0], K[1, 1])).ravel()
        J_corner = corner_jacobian(T, points, K).reshape(-1, 6)
        plane, J_plane = _plane_of(T)
        H = J_corner.T @ W_corner @ J_corner + J_plane.T @ W_plane @ J_plane
        step = -np.linalg.solve(H, J_corner.T @ W_corner @ r_corner + J_plane.T @ W_plane @ (plane - a))
        T = pose(pin.exp3(step[3:]) @ T[:3, :3], T[:3, 3] + step[:3])
        if np.abs(step).max() < last_step:
            return PoseEstimate(read_only(T), read_only(np.linalg.inv(H)))
    return None


def _plane_of(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the plane z = 0 of the pose T, shape (3,) [1/m], and its derivative by changes of T, shape (3, 6)."""
    n, p = -T[:3, 2], T[:3, 3]
    D = n @ p
    J_turn = (np.eye(3) / D - np.outer(n, p) / D**2) @ -pin.skew(n)
    return n / D, np.hstack((-np.outer(n, n) / D**2, J_turn))


def _pose_on_plane(points: np.ndarray, rays: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Returns the pose in the plane a, shape (4, 4) [m], z to the camera, corners nearest to where their rays end."""
    met = rays / (rays @ a)[:, None]
    z = -unit(a)
    x = unit(np.cross((0.0, 1.0, 0.0), z))
    R_plane = np.column_stack((x, np.cross(z, x), z))
    flat, goal = (points - points.mean(axis=0))[:, :2], ((met - met.mean(axis=0)) @ R_plane)[:, :2]
    turn = np.arctan2(np.sum(flat[:, 0] * goal[:, 1] - flat[:, 1] * goal[:, 0]), np.sum(flat * goal))
    R = R_plane @ rotation_about(2, turn)
    return pose(R, met.mean(axis=0) - R @ points.mean(axis=0))


def _change(T: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Returns translation and small rotation about the camera's axes from T to the other pose, shape (6,) [m, rad]."""
    return np.concatenate((other[:3, 3] - T[:3, 3], pin.log3(other[:3, :3] @ T[:3, :3].T)))
