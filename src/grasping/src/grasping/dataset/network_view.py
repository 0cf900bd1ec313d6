"""What is kept of a depth picture: its window in millimetres, the network's maps before smoothing, GGCNN's grasp."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from grasping.dataset.episode import NONE_MM
from grasping.depth_image import Crop, prepare
from grasping.maps import Peak, Smoothing, highest, smoothed
from grasping.predictor import run

MAP_SIDE = 150
"""Rows and columns of the kept maps: half of the network's, which its smoothing by 5 px outweighs."""
LARGEST_MM = np.iinfo(np.uint16).max


class NetworkView(NamedTuple):
    """What is kept.

    Attributes:
        depth: shape (side, side), uint16 [mm], 0 = no reading.
        maps: shape (4, MAP_SIDE, MAP_SIDE), float16: quality, cos, sin, width.
        mean: what was taken off the network's picture [m].
        peak: of the smoothed quality, in the network's picture.
    """

    depth: np.ndarray
    maps: np.ndarray
    mean: float
    peak: Peak


def look(network, depth: np.ndarray, crop: Crop, smoothing: Smoothing) -> NetworkView:
    """Returns what is kept of a depth picture.

    Args:
        network: as `predictor.frozen` returns it.
        depth: the camera's picture, shape (h, w) [m], not finite = no reading.
        crop: the window that the network sees.
        smoothing: before GGCNN's grasp is looked for.

    Raises:
        ValueError: the window holds no reading, or the network says something that is not finite.
    """
    # The network sees what is kept, so that its maps can be computed from the file again.
    window = millimetres(depth[crop.row : crop.row + crop.side, crop.column : crop.column + crop.side])
    picture = prepare(window * np.float32(0.001), Crop(0, 0, crop.side))
    output = run(network, picture.input)
    if not np.isfinite(output).all():
        raise ValueError("the network's maps are not finite")
    small = cv2.resize(output.transpose(1, 2, 0), (MAP_SIDE, MAP_SIDE), interpolation=cv2.INTER_AREA)
    peak = highest(smoothed(output, picture.valid, smoothing))
    return NetworkView(window, small.transpose(2, 0, 1).astype(np.float16), picture.mean, peak)


def millimetres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth picture [m] in whole millimetres, uint16, 0 where there is no reading or it is too far away."""
    with np.errstate(invalid="ignore"):
        whole = np.rint(1000.0 * depth)
        known = np.isfinite(whole) & (whole > 0.0) & (whole <= LARGEST_MM)
    return np.where(known, whole, NONE_MM).astype(np.uint16)
