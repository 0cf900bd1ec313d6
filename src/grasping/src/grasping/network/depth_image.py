"""From a depth image to the network's input: crop, fill holes, scale to 300 x 300, take off the mean; and its planes.

The steps are those of the published node (ggcnn_kinova_grasping), except that holes are filled before the image is
scaled: a missing pixel would otherwise spoil all that are interpolated from it.
A plane is a vector a as in `common.plane_fit`; a structured-light camera has nearly constant noise in inverse depth.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from common.plane_fit import GATE_SD, fit_plane

CAMERA, TABLE = "camera", "table"  # views as named in ggcnn.yaml, in datasets and in weight files
VIEWS = (CAMERA, TABLE)
NETWORK_SIDE = 300
CROP_SIDE = 400
NOISE = 0.003  # standard deviation of a pixel's inverse depth [1/m]
EVERY = 5  # step between the rows and columns that are used


class Crop(NamedTuple):
    """A square window of the camera's image."""

    row: int  # first row
    column: int  # first column
    side: int  # rows and columns


class NetworkImage(NamedTuple):
    """What the network sees."""

    crop: Crop  # where it was cut from the camera's image
    input: np.ndarray  # network input, shape (300, 300), float32, in [-1, 1] [m]
    depth: np.ndarray  # the same without holes and with its mean, shape (300, 300) [m]
    valid: np.ndarray  # where the camera had a reading, shape (300, 300), bool
    mean: float  # what was taken off [m]


def centre_crop(shape: tuple[int, ...], side: int = CROP_SIDE, rows_up: int = 0) -> Crop:
    """Returns the middle window of an image of `shape`, moved up by `rows_up`; raises ValueError if it does not fit."""
    row, column = (shape[0] - side) // 2 - rows_up, (shape[1] - side) // 2
    if side < 1 or row < 0 or column < 0 or row + side > shape[0]:
        raise ValueError(f"a crop of {side} x {side}, moved up by {rows_up}, does not fit {shape[1]} x {shape[0]}")
    return Crop(row, column, side)


def prepare(depth: np.ndarray, crop: Crop, side: int = NETWORK_SIDE) -> NetworkImage:
    """Returns the network's image of a window of the camera's, shape (h, w) [m]; not finite or not positive = no
    reading. Raises ValueError if the window holds no reading.
    """
    window = depth[crop.row : crop.row + crop.side, crop.column : crop.column + crop.side].astype(np.float32)
    valid = np.isfinite(window) & (window > 0.0)
    if not valid.any():
        raise ValueError("the depth image holds no reading inside the crop")
    scaled = cv2.resize(fill_holes(window, valid), (side, side), interpolation=cv2.INTER_LINEAR)
    seen = cv2.resize(valid.astype(np.uint8), (side, side), interpolation=cv2.INTER_NEAREST) > 0
    mean = float(scaled.mean())
    return NetworkImage(crop, np.clip(scaled - mean, -1.0, 1.0), scaled, seen, mean)


def fill_holes(depth: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Returns the image inpainted (Navier-Stokes) where not `valid`, shape (h, w), float32 [m]; one pixel must be."""
    if valid.all():
        return depth
    # The method leaves the outermost pixels alone: a mirrored border of one pixel makes them inner ones.
    known = np.where(valid, depth, np.float32(0.0))
    bordered = cv2.copyMakeBorder(known, 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    holes = cv2.copyMakeBorder((~valid).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    scale = float(np.abs(bordered).max())
    filled = cv2.inpaint(bordered / np.float32(scale), holes, 1, cv2.INPAINT_NS)
    return filled[1:-1, 1:-1] * np.float32(scale)


class PlaneFound(NamedTuple):
    """A plane in an image."""

    a: np.ndarray  # shape (3,) [1/m]
    share: float  # of the pixels that lie in it

    @property
    def direction(self) -> np.ndarray:
        """Unit vector across the plane, away from the camera, shape (3,)."""
        return self.a / np.linalg.norm(self.a)

    @property
    def distance(self) -> float:
        """Of the plane from the camera [m]."""
        return float(1.0 / np.linalg.norm(self.a))


def best_plane(rays: np.ndarray, depth: np.ndarray, noise: float) -> PlaneFound | None:
    """Returns the plane that most pixels lie in, None if there are too few; the same pixels give the same plane.
    `rays`: of the pixels, x, y, 1, shape (n, 3); `depth`: shape (n,) [m], finite and positive; `noise`: standard
    deviation of the inverse depth [1/m].
    """
    if len(depth) < 3:
        return None
    rays, inverse = rays.astype(float), 1.0 / depth.astype(float)
    try:
        a, _, _ = fit_plane(rays, inverse, noise)
    except (ValueError, np.linalg.LinAlgError):  # no three pixels that are not in a row
        return None
    return PlaneFound(a, float(np.mean(np.abs(rays @ a - inverse) < GATE_SD * noise))) if a.any() else None
