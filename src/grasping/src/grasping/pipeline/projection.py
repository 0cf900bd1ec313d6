"""From a grasp in the network's image to a grasp before the camera, and the surface that it approaches.

The frame of a grasp: z the approach, at first along the camera's axis; x through both fingers, so that a grasp of angle
0 has the camera's axes. Angles in the image run anticlockwise and y runs down: a turn about z by minus the angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.config import choice, integer, number
from common.poses import pose, read_only
from common.rotations import rotation_about
from grasping.network.depth_image import NETWORK_SIDE, Crop, NetworkImage, best_plane
from grasping.network.maps import Peak

BETWEEN_ROWS = slice(100, 140)
BETWEEN_COLUMNS = slice(130, 170)  # and rows: a hand's fingers in the network's 300 x 300 image (published node)
VIEW, NORMAL, VERTICAL = "camera", "normal", "vertical"


class CameraGrasp(NamedTuple):
    """A grasp before the camera."""

    T_camera_grasp: np.ndarray  # shape (4, 4) [m]; its origin is the surface between the fingers
    angle: float  # in the image, anticlockwise [rad]
    width: float  # opening [m]
    width_px: float  # opening in the network's image [px]
    quality: float  # about 0 to 1
    pixel: tuple[float, float]  # u, v in the camera's image [px]


def camera_pixel(row: float, column: float, crop: Crop, side: int) -> tuple[float, float]:
    """Returns u, v in the camera's image of a pixel of the network's image with `side` rows and columns."""
    scale = crop.side / side
    # Pixels are squares: their centres, not their corners, lie on each other's grid.
    return crop.column + (column + 0.5) * scale - 0.5, crop.row + (row + 0.5) * scale - 0.5


def pixel_size(image: NetworkImage, camera: CameraModel) -> np.ndarray:
    """Returns what each pixel of the network's image shows of the scene, shape (h, w) [m]."""
    return image.crop.side / len(image.depth) / camera.K[0, 0] * image.depth


def project_grasp(peak: Peak, crop: Crop, side: int, depth: np.ndarray, camera: CameraModel) -> CameraGrasp | None:
    """Returns the grasp before the camera, None when the camera has no reading near the pixel; `crop`: where that image
    lies in the camera's; `depth`: the camera's image, shape (h, w) [m].
    """
    neighbourhood = 5  # rows and columns about the pixel whose readings give the depth
    pixel = camera_pixel(peak.row, peak.column, crop, side)
    column, row = (round(p) for p in pixel)
    half = neighbourhood // 2
    near = depth[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
    near = np.sort(near[np.isfinite(near) & (near > 0.0)])
    if not near.size:
        return None
    middle = near[(near.size - 1) // 2 : near.size // 2 + 1]
    z = float(middle.mean())  # the median; np.median takes twenty times as long
    T = pose(rotation_about(2, -peak.angle), z * camera.rays(pixel))
    width = peak.width * crop.side / side * z / camera.K[0, 0]
    return CameraGrasp(read_only(T), peak.angle, width, peak.width, peak.quality, pixel)


def along(grasp: CameraGrasp, approach: np.ndarray, camera: CameraModel) -> CameraGrasp | None:
    """Returns the grasp, given along the camera's axis and not negatively open, with another approach, a unit vector,
    (3,). The fingers keep their line and pixels in the image: they move in the plane through the grasp across the
    approach. None if the camera looks along that plane.
    """
    # cosine of 75 degrees, the widest angle of view against the approach: beyond, pixels tell little
    least_facing = 0.26
    (px, py, pz), (nx, ny, nz) = grasp.T_camera_grasp[:3, 3].tolist(), np.asarray(approach, dtype=float).tolist()
    half = 0.5 * grasp.width * float(camera.K[0, 0]) / pz
    long = max(half, 1.0)  # a closed gripper has a line too
    (u, v), du, dv = grasp.pixel, long * math.cos(grasp.angle), -long * math.sin(grasp.angle)
    ends = []
    for x, y, z in camera.rays([(u - du, v - dv), (u + du, v + dv)]).tolist():
        along_n = x * nx + y * ny + z * nz
        if along_n < least_facing * math.sqrt(x * x + y * y + z * z):
            return None
        far = (px * nx + py * ny + pz * nz) / along_n
        ends.append((far * x, far * y, far * z))
    ax, ay, az = (end - start for start, end in zip(*ends))
    length = math.sqrt(ax * ax + ay * ay + az * az)
    x, y, z = ax / length, ay / length, az / length
    T = [
        (x, ny * z - nz * y, nx, px),
        (y, nz * x - nx * z, ny, py),
        (z, nx * y - ny * x, nz, pz),
        (0.0, 0.0, 0.0, 1.0),
    ]
    return grasp._replace(T_camera_grasp=read_only(T), width=length * half / long)


def seen_by(camera: CameraModel, T_camera_grasp: np.ndarray, width: float) -> tuple[float, tuple[float, float], float]:
    """Returns a grasp's angle [rad], pixel (u, v) and opening [px] in an image; its pose is (4, 4) [m], `width` [m]."""
    closed_m = 1e-4  # half the opening of fingers that touch: small, but with a direction
    p, x = T_camera_grasp[:3, 3], T_camera_grasp[:3, 0]
    half = max(0.5 * width, closed_m)
    left, right, middle = camera.project([p - half * x, p + half * x, p]).tolist()
    du, dv = right[0] - left[0], right[1] - left[1]
    angle = math.atan(-dv / du) if du else 0.5 * math.pi
    return angle, tuple(middle), math.hypot(du, dv) * 0.5 * float(width) / half


def depth_between_fingers(depth: np.ndarray, crop: Crop) -> float:
    """Returns the mean of the ten nearest readings between the fingers [m], NaN if fewer; `depth`: (h, w) [m]."""
    between_count = 10
    rows, columns = (
        slice(first + part.start * crop.side // NETWORK_SIDE, first + part.stop * crop.side // NETWORK_SIDE)
        for first, part in ((crop.row, BETWEEN_ROWS), (crop.column, BETWEEN_COLUMNS))
    )
    window = depth[rows, columns]
    near = window[np.isfinite(window) & (window > 0.0)]
    if near.size < between_count:
        return float("nan")
    return float(np.partition(near, between_count - 1)[:between_count].mean())


@dataclass(frozen=True)
class ApproachConfig:
    """How a hand comes to a grasp."""

    kind: str = choice(VIEW, NORMAL, VERTICAL, doc="along the axis of the view, across the surface, or down")
    radius: float = number("m", above=0.0, high=0.2, doc="of the surface about the grasp that its plane is fitted to")
    noise: float = number("1/m", above=0.0, high=0.1, doc="standard deviation of a pixel's inverse depth")
    min_pixels: int = integer("px", low=10, high=400, doc="fewer pixels make no surface")
    min_share: float = number(above=0.0, high=1.0, doc="of them that must lie in one plane")
    max_tilt: float = number("deg", above=0.0, high=75.0, doc="largest angle between the approach and the view's axis")


def surface_normal(
    depth: np.ndarray, rays: np.ndarray, pixel: tuple[float, float], z: float, focal: float, config: ApproachConfig
) -> np.ndarray | None:
    """Returns the surface's normal at a grasp, a unit vector into it in the camera's frame, shape (3,), None if not
    clear: too few readings, no plane, or tilted too far. The plane is the one in which most pixels within the radius
    before and behind the grasp lie. `depth`: shape (h, w) [m], NaN = none; `rays`: of its pixels, shape (h, w, 3);
    `pixel`: u, v of the grasp; `z`: its depth [m]; `focal`: length [px].
    """
    max_pixels = 400
    half = max(2, round(config.radius * focal / z))
    column, row = (round(p) for p in pixel)
    window = slice(max(0, row - half), row + half + 1), slice(max(0, column - half), column + half + 1)
    near = depth[window]
    with np.errstate(invalid="ignore"):
        known = np.flatnonzero(np.abs(near - z) < config.radius)
    if len(known) < config.min_pixels:
        return None
    known = known[:: max(1, len(known) // max_pixels)]
    plane = best_plane(rays[window].reshape(-1, 3)[known], near.ravel()[known], config.noise)
    if plane is None or plane.share < config.min_share:
        return None
    tilt = np.degrees(np.arccos(np.clip(plane.direction[2], -1.0, 1.0)))
    return plane.direction if tilt <= config.max_tilt else None
