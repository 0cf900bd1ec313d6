"""From a depth image to the network's input: crop, fill the holes, scale to 300 x 300, take off the mean.

The steps are those of the published node (ggcnn_kinova_grasping), except that holes are filled before the image is
scaled: a missing pixel would otherwise spoil all that are interpolated from it.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

CAMERA, TABLE = "camera", "table"
"""The views by their names in ggcnn.yaml, in datasets and in weight files of the refinement network."""
VIEWS = (CAMERA, TABLE)
NETWORK_SIDE = 300
CROP_SIDE = 400


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
    """Returns the window in the middle of an image of `shape`, moved up by `rows_up`.

    Raises:
        ValueError: it does not lie in the image.
    """
    row, column = (shape[0] - side) // 2 - rows_up, (shape[1] - side) // 2
    if side < 1 or row < 0 or column < 0 or row + side > shape[0]:
        raise ValueError(f"a crop of {side} x {side}, moved up by {rows_up}, does not fit {shape[1]} x {shape[0]}")
    return Crop(row, column, side)


def prepare(depth: np.ndarray, crop: Crop, side: int = NETWORK_SIDE) -> NetworkImage:
    """Returns the network's image of a window of the depth image.

    Args:
        depth: the camera's image, shape (h, w) [m]; NaN, infinite and non-positive values mean no reading.

    Raises:
        ValueError: the window holds no reading at all.
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
    """Returns the image with its holes filled by Navier-Stokes inpainting, shape as `depth`, float32 [m].

    Args:
        depth: shape (h, w), float32 [m].
        valid: where `depth` holds a reading; at least one pixel does.
    """
    if valid.all():
        return depth
    # The method leaves the outermost pixels alone: a mirrored border of one pixel makes them inner ones.
    known = np.where(valid, depth, np.float32(0.0))
    bordered = cv2.copyMakeBorder(known, 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    holes = cv2.copyMakeBorder((~valid).astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_DEFAULT)
    scale = float(np.abs(bordered).max())
    filled = cv2.inpaint(bordered / np.float32(scale), holes, 1, cv2.INPAINT_NS)
    return filled[1:-1, 1:-1] * np.float32(scale)
