"""The plane of the marker board in a raw depth image. A plane is a vector a, shape (3,) [1/m], with a . X = 1 for its
points X; it equals n / D with the unit normal n and the distance D. Along a pixel's ray (x, y, 1) the inverse depth is
1/z = a . ray, which is linear in a. The noise of a structured-light sensor and the smooth errors of a unit are nearly
constant in inverse depth, so the plane is fitted there. The registered image is not used, because it has holes and
repeated pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.config import integer, number
from common.plane_fit import fit_plane


@dataclass(frozen=True)
class PlanePoseConfig:
    """The schema of plane_pose.yaml."""

    outline_share: float = number(above=0.0, high=1.0, doc="fraction of the plate's edges that is used")
    outline_px: float = number("px", low=0.0, high=50.0, doc="distance from the outline in the depth image")
    noise: float = number("1/m", above=0.0, high=0.1, doc="maximum standard deviation of a pixel's inverse depth")
    noise_floor: float = number("m", low=0.0, high=0.1, doc="additional standard deviation of depth; counts when near")
    noise_pixels: float = number("px", low=1.0, high=1000.0, doc="number of neighbouring pixels that share their noise")
    min_pixels: int = integer("px", low=10, high=100000, doc="minimum number of pixels with a depth")
    min_cover: float = number(above=0.0, high=1.0, doc="minimum number of pixels with a depth, as fraction of all")
    min_inliers: float = number(above=0.5, high=1.0, doc="minimum fraction of them in one plane")
    corner_sd: float = number("px", above=0.0, high=10.0, doc="standard deviation of a tag's corner")
    focal_sd: float = number(low=0.0, high=0.1, doc="relative standard deviation of the colour focal length")
    scale_sd: float = number(low=0.0, high=0.1, doc="relative standard deviation of the depth scale")
    warp_sd: float = number("1/m", low=0.0, high=0.1, doc="standard deviation of the smooth error of inverse depth")
    warp_slope_sd: float = number("1/m", low=0.0, high=1.0, doc="of its slope, over the tangent of the viewing angle")
    max_disagreement: float = number(above=0.0, high=100.0, doc="standard deviations between range by colour and depth")


@dataclass(frozen=True, eq=False)
class PlaneFit:
    """A plane, or the reason why there is none."""

    a: np.ndarray | None  # the plane, shape (3,) [1/m], or None
    covariance: np.ndarray | None  # of a, from noise and the unit's errors, shape (3, 3) [1/m^2], or None
    pixels: int  # number of outline pixels with a depth near the marker board's
    cover: float  # fraction of the outline that they cover
    inliers: float  # fraction of them in the plane
    rms: float  # rms of the inliers' errors along the axis, in the middle of the marker board [m]
    reason: str = ""  # why there is no plane, without a full stop; empty for a plane


def fit_board(
    depth: np.ndarray, camera: CameraModel, T_depth_board: np.ndarray, plate: float, config: PlanePoseConfig
) -> PlaneFit:
    """Returns the marker board's plane in the depth camera's frame; raises ValueError for an image of another size.
    `depth`: raw, shape (height, width), float32 [m], NaN where unknown; `T_depth_board`: rough pose by the colour
    image, shape (4, 4) [m]; `plate`: edge of the square plate round the board's origin [m]."""
    max_pixels = 2500  # maximum number of pixels: more add no information, as neighbours share their noise
    # depth that differs more, relatively, from the range by colour is background or an arm in front
    range_gate = 0.15
    size = (camera.width, camera.height)
    if depth.shape[::-1] != size:
        raise ValueError(f"the depth image is {depth.shape[::-1]}, but its camera_info says {size}")
    inside = _outline(camera, T_depth_board, plate * config.outline_share, config.outline_px)
    if inside is None or not inside.any():
        return _none("the marker board is outside the depth image: move it towards the centre")
    expected = T_depth_board[2, 3]
    half_tilted = plate * np.hypot(*T_depth_board[2, :2]) / np.sqrt(2.0)
    near = inside & (np.abs(depth - expected) < range_gate * expected + half_tilted)
    count, cover = int(near.sum()), float(near.sum() / inside.sum())
    if count < config.min_pixels or cover < config.min_cover:
        reason = f"only {count} pixels, {cover:.0%} of the marker board, have a depth near it: uncover it"
        return _none(reason, count, cover)
    stride = max(1, count // max_pixels)
    v, u = (index[::stride] for index in np.nonzero(near))
    rays = camera.rays(np.stack((u, v), axis=-1))
    w = 1.0 / depth[v, u].astype(float)
    a, weights, sd = fit_plane(rays, w, config.noise + config.noise_floor / expected**2)
    inliers = float((weights > 0.0).mean())
    if inliers < config.min_inliers:
        found = f"only {inliers:.0%} of the board's pixels lie in one plane"
        return _none(f"{found}: uncover it, and check that the plate is flat", count, cover, inliers)
    shared = max(1.0, config.noise_pixels / stride)
    noise = shared * sd**2 * np.linalg.inv((rays * weights[:, None]).T @ rays)
    middle = T_depth_board[:3, 3] / expected
    rms = sd / (a @ middle) ** 2
    return PlaneFit(a, noise + unit_covariance(a, middle, config), count, cover, inliers, float(rms))


def unit_covariance(a: np.ndarray, middle: np.ndarray, config: PlanePoseConfig) -> np.ndarray:
    """Returns the covariance of the plane a from the errors of the sensor unit, shape (3, 3) [1/m^2]. A wrong scale
    stretches a; over the marker board, whose middle is at the ray `middle` (x, y, 1), the smooth error of inverse depth
    is an offset and two slopes."""
    J = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-middle[0], -middle[1], 1.0]])
    smooth = np.diag(np.square([config.warp_slope_sd, config.warp_slope_sd, config.warp_sd]))
    return config.scale_sd**2 * np.outer(a, a) + J @ smooth @ J.T


def plane_seen_from(T: np.ndarray, a: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the plane a and its covariance in the frame in which its own frame has the pose T, shape (4, 4) [m]."""
    turned = T[:3, :3] @ a
    D = 1.0 + turned @ T[:3, 3]
    J = (np.eye(3) / D - np.outer(turned, T[:3, 3]) / D**2) @ T[:3, :3]
    return turned / D, J @ covariance @ J.T


def _outline(camera: CameraModel, T: np.ndarray, edge: float, inset: float) -> np.ndarray | None:
    """Returns the mask of the square, shape (height, width); None if a corner is behind the camera."""
    corners = edge / 2.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) @ T[:3, :3].T + T[:3, 3]
    if np.any(corners[:, 2] <= 0.0):
        return None
    polygon = np.rint(np.clip(camera.project(corners), -1e4, 1e4)).astype(np.int32)
    mask = np.zeros((camera.height, camera.width), np.uint8)
    cv2.fillConvexPoly(mask, polygon, (1,))
    size = 2 * int(np.ceil(inset)) + 1
    return cv2.erode(mask, np.ones((size, size), np.uint8), borderValue=(1,)).astype(bool)


def _none(reason: str, pixels: int = 0, cover: float = 0.0, inliers: float = 0.0) -> PlaneFit:
    return PlaneFit(None, None, pixels, cover, inliers, 0.0, reason)
