"""From the network's four maps to grasps in the network's image: smooth, find the best pixels.

The steps are those of the published node, except that cos and sin are smoothed and not the angle, which would be spoilt
where it jumps from +90 to -90 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

PARALLEL, REFLEX = HANDS = "parallel", "reflex"  # whose grasps the maps are of; files count them, so new ones come last
WIDTH_SCALE_PX = 150.0  # the opening, in pixels of the network's image, that the width map calls 1
Angles = TypeVar("Angles", float, np.ndarray)
THRESHOLD = 0.2  # lowest quality of a peak where nothing else is configured


@dataclass(frozen=True)
class Smoothing:
    """Standard deviations of the blurs [px]."""

    quality: float = 5.0
    angle: float = 2.0
    width: float = 1.0


class Peak(NamedTuple):
    """A grasp in the network's image."""

    row: int  # of the pixel between the fingers
    column: int  # of that pixel
    quality: float  # about 0 to 1
    angle: float  # as in `Maps` [rad]
    width: float  # opening [px]


class Maps(NamedTuple):
    """What the network says of each pixel, each shape (h, w)."""

    quality: np.ndarray  # about 0 to 1
    angle: np.ndarray  # of the line through both fingers, from the horizontal, anticlockwise, [-pi/2, pi/2] [rad]
    width: np.ndarray  # opening [px]

    def at(self, row: int, column: int) -> Peak:
        return Peak(row, column, *(float(m[row, column]) for m in self))


def smoothed(output: np.ndarray, valid: np.ndarray, smoothing: Smoothing) -> Maps:
    """Returns the smoothed maps; `output`: of the network, shape (4, h, w); `valid`: where the camera had a reading,
    shape (h, w); elsewhere the quality is 0 before it is smoothed.
    """
    quality = gaussian(np.where(valid, output[0], np.float32(0.0)), smoothing.quality)
    cos, sin = (gaussian(part, smoothing.angle) for part in output[1:3])
    width = gaussian(output[3], smoothing.width) * np.float32(WIDTH_SCALE_PX)
    return Maps(quality, np.float32(0.5) * np.arctan2(sin, cos), width)


def half_turn(angles: Angles) -> Angles:
    """Returns angles modulo pi in [-pi/2, pi/2): a grasp is the same after half a turn."""
    return (angles + 0.5 * np.pi) % np.pi - 0.5 * np.pi


def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
    """Returns the image blurred as SciPy's gaussian_filter does: cut at 4 sigma, mirrored at the border."""
    if sigma == 0.0:
        return image
    side = 2 * int(4.0 * sigma + 0.5) + 1
    return cv2.GaussianBlur(image, (side, side), sigma, borderType=cv2.BORDER_REFLECT)


def peaks(maps: Maps, count: int, distance: int = 20, threshold: float = THRESHOLD) -> list[Peak]:
    """Returns the best local maxima of quality, best first, `distance` rows or columns apart and from the border."""
    quality = maps.quality
    rows, columns = (slice(distance, size - distance) for size in quality.shape)
    highest = cv2.dilate(quality, np.ones((3, 3), np.uint8))[rows, columns]
    inner = quality[rows, columns]
    at = np.argwhere((inner == highest) & (inner > threshold)) + distance
    chosen: list[Peak] = []
    for i in np.argsort(-quality[at[:, 0], at[:, 1]], kind="stable"):
        row, column = at[i].tolist()
        around = quality[row - distance : row + distance + 1, column - distance : column + distance + 1]
        apart = all(max(abs(row - p.row), abs(column - p.column)) > distance for p in chosen)
        if apart and quality[row, column] == around.max():
            chosen.append(maps.at(row, column))
            if len(chosen) == count:
                break
    return chosen


def highest(maps: Maps) -> Peak:
    """Returns the pixel of the highest quality."""
    return maps.at(*(int(i) for i in np.unravel_index(np.argmax(maps.quality), maps.quality.shape)))
