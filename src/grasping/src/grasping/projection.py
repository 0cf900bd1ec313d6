"""From a grasp in the network's picture to a grasp before the camera.

The frame of a grasp: z along the camera's axis, the approach; x through both fingers, so that a grasp of angle 0 has
the camera's axes. Angles in the picture run anticlockwise and y runs down: a turn about z by minus the angle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.poses import pose, read_only
from common.rotations import rotation_about
from grasping.depth_image import Crop, Picture
from grasping.maps import Peak

NEIGHBOURHOOD = 5
"""Rows and columns about the pixel whose readings give the depth."""
BETWEEN_ROWS = slice(100, 140)
BETWEEN_COLUMNS = slice(130, 170)
"""Where a hand in front of the camera has its fingers, in the network's 300 x 300 picture (published node)."""
BETWEEN_COUNT = 10


class Grasp(NamedTuple):
    """A grasp before the camera.

    Attributes:
        T_camera_grasp: shape (4, 4) [m]; its origin is the surface between the fingers.
        angle: in the picture, anticlockwise [rad].
        width: opening [m].
        width_px: opening in the network's picture [px].
        quality: about 0 to 1.
        pixel: u, v in the camera's picture [px].
    """

    T_camera_grasp: np.ndarray
    angle: float
    width: float
    width_px: float
    quality: float
    pixel: tuple[float, float]


def camera_pixel(peak: Peak, crop: Crop, side: int) -> tuple[float, float]:
    """Returns u, v in the camera's picture of a pixel of the network's picture with `side` rows and columns."""
    scale = crop.side / side
    # Pixels are squares: their centres, not their corners, lie on each other's grid.
    return crop.column + (peak.column + 0.5) * scale - 0.5, crop.row + (peak.row + 0.5) * scale - 0.5


def grasp(peak: Peak, crop: Crop, side: int, depth: np.ndarray, camera: CameraModel) -> Grasp | None:
    """Returns the grasp before the camera, None when the camera has no reading near the pixel.

    Args:
        peak: in the network's picture.
        crop: where that picture lies in the camera's.
        side: rows and columns of the network's picture.
        depth: the camera's picture, shape (h, w) [m].
        camera: that took it.
    """
    pixel = camera_pixel(peak, crop, side)
    column, row = (round(p) for p in pixel)
    half = NEIGHBOURHOOD // 2
    near = depth[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]
    near = near[np.isfinite(near) & (near > 0.0)]
    if not near.size:
        return None
    z = float(np.median(near))
    T = pose(rotation_about(2, -peak.angle), z * camera.rays(pixel))
    width = peak.width * crop.side / side * z / camera.K[0, 0]
    return Grasp(read_only(T), peak.angle, width, peak.width, peak.quality, pixel)


def depth_between_fingers(picture: Picture) -> float:
    """Returns how far the nearest things between the fingers are, the mean of the ten nearest pixels [m]."""
    window = picture.depth[BETWEEN_ROWS, BETWEEN_COLUMNS]
    return float(np.partition(window, BETWEEN_COUNT, axis=None)[:BETWEEN_COUNT].mean())
