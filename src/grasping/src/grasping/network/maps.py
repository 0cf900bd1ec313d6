"""From the network's four maps to grasps in the network's image: smooth, find the best pixels.

The steps are those of the published node, except that cos and sin are smoothed and not the angle, which would be spoilt
where it jumps from +90 to -90 degrees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

PARALLEL, REFLEX = HANDS = "parallel", "reflex"  # whose grasps the maps are of; files count them, so new ones come last
WIDTH_SCALE_PX = 150.0  # the opening, in pixels of the network's image, that the width map calls 1
HIGHEST_QUALITY = 1.4  # that is expected; a network that says more is evaluated everywhere
THRESHOLD = 0.2  # lowest quality of a peak where nothing else is configured


@dataclass(frozen=True)
class Smoothing:
    """Standard deviations of the blurs [px]."""

    quality: float = 5.0
    angle: float = 2.0
    width: float = 1.0


def reach(smoothing: Smoothing, threshold: float | None) -> int | None:
    """Returns how far from graspable pixels the maps decide on the peaks above a threshold, rows and columns [px]; None
    for everywhere: without a threshold.

    A Gaussian has the fraction exp(-d^2 / (2 sigma^2)) of its mass beyond the distance d. So a pixel as far from all
    graspable ones, whose quality is at most `HIGHEST_QUALITY`, has less than that after the blur. At a peak the blurs
    of angle and opening read what is around it.
    """
    if threshold is None or threshold <= 0.0:
        return None
    peak = smoothing.quality * math.sqrt(2.0 * math.log(max(1.0, HIGHEST_QUALITY / threshold)))
    farthest = min(radius(smoothing.quality), math.ceil(peak))
    return farthest + max(radius(smoothing.angle), radius(smoothing.width))


class Maps(NamedTuple):
    """What the network says of each pixel, each shape (h, w)."""

    quality: np.ndarray  # about 0 to 1
    angle: np.ndarray  # of the line through both fingers, from the horizontal, anticlockwise, [-pi/2, pi/2] [rad]
    width: np.ndarray  # opening [px]


class Peak(NamedTuple):
    """A grasp in the network's image."""

    row: int  # of the pixel between the fingers
    column: int  # of that pixel
    quality: float  # about 0 to 1
    angle: float  # as in `Maps` [rad]
    width: float  # opening [px]


def smoothed(output: np.ndarray, valid: np.ndarray, smoothing: Smoothing) -> Maps:
    """Returns the smoothed maps; `output`: of the network, shape (4, h, w); `valid`: where the camera had a reading,
    shape (h, w); elsewhere the quality is 0 before it is smoothed.
    """
    quality, cos, sin, width = output
    quality = gaussian(np.where(valid, quality, np.float32(0.0)), smoothing.quality)
    angle = 0.5 * np.arctan2(gaussian(sin, smoothing.angle), gaussian(cos, smoothing.angle))
    return Maps(quality, angle, gaussian(width, smoothing.width) * np.float32(WIDTH_SCALE_PX))


def radius(sigma: float) -> int:
    """Returns how far the blur reaches [px]."""
    return int(4.0 * sigma + 0.5)


def gaussian(image: np.ndarray, sigma: float) -> np.ndarray:
    """Returns the image blurred as SciPy's gaussian_filter does: cut at 4 sigma, mirrored at the border."""
    if sigma == 0.0:
        return image
    side = 2 * radius(sigma) + 1
    return cv2.GaussianBlur(image, (side, side), sigma, borderType=cv2.BORDER_REFLECT)


def peaks(maps: Maps, count: int, distance: int = 20, threshold: float = THRESHOLD) -> list[Peak]:
    """Returns the best local maxima of quality, best first, `distance` rows or columns apart and from the border."""
    quality = maps.quality
    highest = cv2.dilate(quality, np.ones((2 * distance + 1, 2 * distance + 1), np.uint8))
    is_peak = (quality == highest) & (quality > threshold)
    inner = np.zeros_like(is_peak)
    inner[distance : len(quality) - distance, distance : quality.shape[1] - distance] = True
    rows, columns = np.nonzero(is_peak & inner)
    chosen: list[Peak] = []
    for i in np.argsort(-quality[rows, columns], kind="stable"):
        row, column = int(rows[i]), int(columns[i])
        if all(max(abs(row - p.row), abs(column - p.column)) > distance for p in chosen):
            chosen.append(peak_at(maps, row, column))
            if len(chosen) == count:
                break
    return chosen


def highest(maps: Maps) -> Peak:
    """Returns the pixel of the highest quality."""
    return peak_at(maps, *(int(i) for i in np.unravel_index(np.argmax(maps.quality), maps.quality.shape)))


def peak_at(maps: Maps, row: int, column: int) -> Peak:
    """Returns the grasp at a pixel."""
    return Peak(row, column, *(float(m[row, column]) for m in maps))
