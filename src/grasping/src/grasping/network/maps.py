"""From the network's four maps to grasps in the network's image: smooth, find the best pixels.

The steps are those of the published node, except that cos and sin are smoothed and not the angle, which would be spoilt
where it jumps from +90 to -90 degrees.
"""

from __future__ import annotations

import copy
import functools
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

PARALLEL, REFLEX = HANDS = "parallel", "reflex"  # whose grasps the maps are of; files count them, so new ones come last
WIDTH_SCALE_PX = 150.0  # the opening, in pixels of the network's image, that the width map calls 1
HIGHEST_QUALITY = 1.4  # that is expected; a network that says more is evaluated everywhere
ROUNDED = 0.999  # a blur in single precision is off by less
THRESHOLD = 0.2  # lowest quality of a peak where nothing else is configured


@dataclass(frozen=True)
class Smoothing:
    """Standard deviations of the blurs [px]."""

    quality: float = 5.0
    angle: float = 2.0
    width: float = 1.0


def decisive(graspable: np.ndarray, smoothing: Smoothing, threshold: float | None) -> np.ndarray | None:
    """Returns where the maps decide on the peaks above a threshold, shape (h, w), bool; None for everywhere: without a
    threshold. `graspable`: shape (h, w), bool, with even sides.

    Peaks are where the blurred quality is above the threshold, which it cannot be if `HIGHEST_QUALITY` in each
    graspable pixel is not enough. There the blurs of angle and opening read what is around a peak. This is decided for
    blocks of 2 x 2 pixels, which count as graspable if one of them is.
    """
    if threshold is None or threshold <= 0.0:
        return None
    halves = blocks(graspable, 2)
    above = halves
    if smoothing.quality > 0.0:
        weights = _block_weights(smoothing.quality)
        share = cv2.sepFilter2D(halves.astype(np.float32), -1, weights, weights, borderType=cv2.BORDER_REFLECT)
        above = share > ROUNDED * threshold / HIGHEST_QUALITY
    read = -(-max(radius(smoothing.angle), radius(smoothing.width)) // 2)
    return enlarged(near(above, read) | halves, 2)


@functools.lru_cache(maxsize=16)
def _block_weights(sigma: float) -> np.ndarray:
    """Returns the weight that a Gaussian's blur of one pixel gives to two neighbours, at most, by their distance in
    such blocks.
    """
    reached = radius(sigma) // 2 + 1
    pixel = cv2.getGaussianKernel(2 * radius(sigma) + 1, sigma, cv2.CV_32F).ravel()
    padded = np.pad(pixel, 2 * reached + 2 - radius(sigma))  # its middle is at 2 reached + 2
    pairs = padded[:-1] + padded[1:]
    return np.maximum(pairs[1:-1:2], pairs[2::2])


def blocks(mask: np.ndarray, side: int) -> np.ndarray:
    """Returns which blocks of `side` rows and columns hold anything, shape (h / side, w / side), bool."""
    rows = np.logical_or.reduce([mask[i::side] for i in range(side)])
    return np.logical_or.reduce([rows[:, i::side] for i in range(side)])


def enlarged(mask: np.ndarray, factor: int) -> np.ndarray:
    """Returns the mask with each pixel as a block of `factor` rows and columns."""
    return mask.repeat(factor, axis=0).repeat(factor, axis=1)


def near(mask: np.ndarray, distance: int) -> np.ndarray:
    """Returns what is within `distance` rows and columns of the mask, bool."""
    return cv2.dilate(mask.view(np.uint8), np.ones((2 * distance + 1, 2 * distance + 1), np.uint8)).view(bool)


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
        """Returns the grasp at a pixel."""
        return Peak(row, column, *(float(m[row, column]) for m in self))

    def with_quality(self, quality: np.ndarray) -> Maps:
        """Returns the maps with another quality, shape (h, w)."""
        return self._replace(quality=quality)


class SmoothedMaps:
    """The maps of `smoothed`; angle and opening are computed where they are asked for."""

    def __init__(self, output: np.ndarray, valid: np.ndarray, smoothing: Smoothing) -> None:
        self._output, self._smoothing = output, smoothing
        self.quality = np.zeros(valid.shape, np.float32)
        reached, (x, y, w, h) = radius(smoothing.quality), cv2.boundingRect(valid.view(np.uint8))
        # Beyond the blur's reach the quality is 0.
        part = slice(max(0, y - reached), y + h + reached), slice(max(0, x - reached), x + w + reached)
        self.quality[part] = gaussian(np.where(valid[part], output[0][part], np.float32(0.0)), smoothing.quality)

    @functools.cached_property
    def angle(self) -> np.ndarray:
        """As in `Maps`."""
        return _angle(*(gaussian(part, self._smoothing.angle) for part in self._output[1:3]))

    @functools.cached_property
    def width(self) -> np.ndarray:
        """As in `Maps`."""
        return gaussian(self._output[3], self._smoothing.width) * np.float32(WIDTH_SCALE_PX)

    def at(self, row: int, column: int) -> Peak:
        """Returns the grasp at a pixel."""
        cos, sin = (_blurred_pixel(part, row, column, self._smoothing.angle) for part in self._output[1:3])
        width = _blurred_pixel(self._output[3], row, column, self._smoothing.width) * np.float32(WIDTH_SCALE_PX)
        return Peak(row, column, float(self.quality[row, column]), float(_angle(cos, sin)), float(width))

    def with_quality(self, quality: np.ndarray) -> SmoothedMaps:
        """Returns the maps with another quality, shape (h, w)."""
        other = copy.copy(self)
        other.quality = quality
        return other

    def everywhere(self) -> Maps:
        """Returns all three maps."""
        return Maps(self.quality, self.angle, self.width)


def smoothed(output: np.ndarray, valid: np.ndarray, smoothing: Smoothing) -> Maps:
    """Returns the smoothed maps; `output`: of the network, shape (4, h, w); `valid`: where the camera had a reading,
    shape (h, w); elsewhere the quality is 0 before it is smoothed.
    """
    return SmoothedMaps(output, valid, smoothing).everywhere()


def _angle(cos: np.ndarray | np.float32, sin: np.ndarray | np.float32) -> np.ndarray:
    return np.float32(0.5) * np.arctan2(sin, cos)


def _blurred_pixel(image: np.ndarray, row: int, column: int, sigma: float) -> np.float32:
    """Returns a pixel of the blurred image."""
    top, left = max(0, row - radius(sigma)), max(0, column - radius(sigma))
    around = image[top : row + radius(sigma) + 1, left : column + radius(sigma) + 1]
    # At the image's border the part is mirrored as the whole image is.
    return gaussian(np.ascontiguousarray(around), sigma)[row - top, column - left]


def radius(sigma: float) -> int:
    """Returns how far the blur reaches [px]."""
    return int(4.0 * sigma + 0.5)


def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
    """Returns the image blurred as SciPy's gaussian_filter does: cut at 4 sigma, mirrored at the border."""
    if sigma == 0.0:
        return image
    side = 2 * radius(sigma) + 1
    return cv2.GaussianBlur(image, (side, side), sigma, borderType=cv2.BORDER_REFLECT)


def peaks(maps: Maps | SmoothedMaps, count: int, distance: int = 20, threshold: float = THRESHOLD) -> list[Peak]:
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


def highest(maps: Maps | SmoothedMaps) -> Peak:
    """Returns the pixel of the highest quality."""
    return maps.at(*(int(i) for i in np.unravel_index(np.argmax(maps.quality), maps.quality.shape)))
