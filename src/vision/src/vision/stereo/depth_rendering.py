"""Renders the image of one eye from a colour image and its depth (depth-image-based rendering).

The two eyes look along the camera's axis, half their distance to its left and right. A point at depth z then lies
f b / z pixels farther to the right in the left eye's image than in the right eye's, so that it appears at its true
distance. Both images must be rectified and have the same pixels.
"""

from __future__ import annotations

import cv2
import numpy as np

LEFT, RIGHT = 1, -1
"""The eyes: the direction in which their images shift as an object comes nearer."""
NONE = np.float32(-1e6)
"""Marks a pixel of a map to which no image pixel moved."""


def inverse_depth(depth: np.ndarray, nearest: float, instead: float) -> np.ndarray:
    """Returns 1/z for every pixel, float32 [1/m].

    A pixel without depth (NaN, infinite, not positive) gets the depth of the farther of its neighbours to the left and
    right, because most gaps are shadows of near objects. A row without any depth gets the farthest of all depths.

    Args:
        depth: shape (height, width) [m].
        nearest: smaller depths are replaced by this one [m].
        instead: depth for an image without any [m].
    """
    known = np.isfinite(depth) & (depth > 0.0)
    if not known.any():
        return np.full(depth.shape, 1.0 / instead, np.float32)
    near = np.divide(1.0, depth, out=np.full(depth.shape, np.inf, np.float32), where=known, dtype=np.float32)
    farthest = near.min()
    rows, holes = np.nonzero(~known)
    left, right = (columns[rows, holes] for columns in _neighbours(known))
    from_left = np.where(left >= 0, near[rows, left], np.inf)
    from_right = np.where(right >= 0, near[rows, right], np.inf)
    filled = np.minimum(from_left, from_right)
    near[rows, holes] = np.where(np.isfinite(filled), filled, farthest)
    return np.minimum(near, np.float32(1.0 / nearest), out=near)


def eye_map(shift: np.ndarray, eye: int) -> np.ndarray:
    """Returns the image column that each pixel of an eye's image shows, shape (height, width), float32 [px].

    Where several pixels coincide, the nearest wins. A hole, which opens beside a near object, shows the edge of the
    background. Columns outside the image are outside the camera's view.

    Args:
        shift: half the disparity of each pixel, not negative [px].
        eye: LEFT or RIGHT.
    """
    height, width = shift.shape
    # A later assignment wins. The left eye's pixels move right: of those that coincide, the nearest began leftmost.
    order = slice(None, None, -1 if eye == LEFT else 1)
    move = eye * shift[:, order]
    target = np.rint(np.arange(width, dtype=np.float32)[order] + move)
    inside = (target >= 0) & (target < width)
    pixel = width * np.arange(height, dtype=np.int32)[:, None] + target.astype(np.int32)
    source = np.full(height * width, NONE, np.float32)
    source[pixel[inside]] = (target - move)[inside]
    return _without_holes(source.reshape(height, width), eye)


def shifted(image: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Returns the image, shape (height, width, 3), read at the columns of `eye_map`; black outside."""
    rows = np.broadcast_to(np.arange(columns.shape[0], dtype=np.float32)[:, None], columns.shape)
    return cv2.remap(image, columns, np.ascontiguousarray(rows), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)


def _without_holes(source: np.ndarray, eye: int) -> np.ndarray:
    known = source > NONE
    if known.all():
        return source
    rows, holes = np.nonzero(~known)
    left, right = (columns[rows, holes] for columns in _neighbours(known))
    # The neighbour that moved less is farther away; at the edge there is only one neighbour.
    moved_left = np.where(left >= 0, eye * (left - source[rows, left]), np.inf)
    moved_right = np.where(right >= 0, eye * (right - source[rows, right]), np.inf)
    behind = np.where(moved_left <= moved_right, left, right)
    at_edge = (left < 0) | (right < 0)
    source[rows, holes] = source[rows, behind] + np.where(at_edge, holes - behind, 0)
    return source


def _neighbours(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the nearest known column at or left of each pixel, and at or right of it; -1 where there is none."""
    width = known.shape[1]
    columns = np.arange(width, dtype=np.int32)
    left = np.maximum.accumulate(np.where(known, columns, -1), axis=1)
    right = np.minimum.accumulate(np.where(known, columns, width)[:, ::-1], axis=1)[:, ::-1]
    return left, np.where(right < width, right, -1)
