"""Grasps without a network, for comparison: all see the same image and return a grasp in it, or None.

A plane is fitted to the image; what stands out of it is an object. Openings in pixels of the image.
"""

from __future__ import annotations

import cv2
import numpy as np

from grasping.network.depth_image import NetworkImage
from grasping.network.maps import Peak

OUTSTANDING_M = 0.012
PLANE_ROUNDS = 8
PLANE_BAND_M = 0.01
CLEARANCE_PX = 5.0
SMALLEST_OBJECT_PX = 60
EDGE_STEP_M = 0.006
"""Least step of depth across a pixel that is an edge."""
EDGE_PAIRS = 4000
FRICTION_ANGLE_RAD = 0.46
"""atan 0.5."""


def random_pixel(image: NetworkImage, widest: float, rng: np.random.Generator) -> Peak | None:
    """Returns any pixel of an object with any angle, fully open."""
    rows, columns = np.nonzero(object_mask(image))
    if not len(rows):
        return None
    i = rng.integers(len(rows))
    return Peak(int(rows[i]), int(columns[i]), 0.5, float(rng.uniform(-0.5, 0.5) * np.pi), widest)


def principal_axis(image: NetworkImage, widest: float, _rng: np.random.Generator) -> Peak | None:
    """Returns the middle of the largest object, across its shorter principal axis."""
    count, parts, sizes, centres = cv2.connectedComponentsWithStats(object_mask(image).astype(np.uint8))
    if count < 2:
        return None
    part = 1 + int(np.argmax(sizes[1:, cv2.CC_STAT_AREA]))
    points = np.argwhere(parts == part)[:, ::-1] - centres[part]
    axis = np.linalg.eigh(points.T @ points)[1][:, 0]
    extent = np.ptp(points @ axis) + 1.0
    column, row = (round(float(c)) for c in centres[part])
    angle = float(np.arctan2(-axis[1], axis[0]))
    return Peak(row, column, 0.5, (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi, min(widest, extent + 2.0 * CLEARANCE_PX))


def edge_pair(image: NetworkImage, widest: float, rng: np.random.Generator) -> Peak | None:
    """Returns the pair of opposite depth edges that face each other best."""
    smooth = cv2.GaussianBlur(image.depth, (0, 0), 1.0)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) / 8.0, cv2.Sobel(smooth, cv2.CV_32F, 0, 1) / 8.0
    size = np.hypot(gx, gy)
    rows, columns = np.nonzero((size > EDGE_STEP_M) & object_mask(image, margin=2))
    if len(rows) < 2:
        return None
    # The depth grows outwards across the edge of an object.
    outwards = np.stack([gx, gy], axis=-1)[rows, columns] / size[rows, columns][:, None]
    a, b = rng.integers(0, len(rows), (2, EDGE_PAIRS))
    line = np.stack([columns[b] - columns[a], rows[b] - rows[a]], axis=-1).astype(float)
    length = np.linalg.norm(line, axis=1)
    line /= np.maximum(length, 1e-9)[:, None]
    worst = np.minimum((outwards[b] * line).sum(axis=1), -(outwards[a] * line).sum(axis=1))
    fits = (length > 4.0) & (length + 2.0 * CLEARANCE_PX < widest)
    worst = np.where(fits, worst, -1.0)
    i = int(np.argmax(worst))
    if worst[i] < np.cos(FRICTION_ANGLE_RAD):
        return None
    row, column = (round(0.5 * float(v[a[i]] + v[b[i]])) for v in (rows, columns))
    angle = float(np.arctan2(-line[i, 1], line[i, 0]))
    angle = (angle + 0.5 * np.pi) % np.pi - 0.5 * np.pi
    return Peak(row, column, float(worst[i]), angle, float(length[i] + 2.0 * CLEARANCE_PX))


HEURISTICS = {"random pixel": random_pixel, "principal axis": principal_axis, "edge pair": edge_pair}


def object_mask(image: NetworkImage, margin: int = 0) -> np.ndarray:
    """Returns where something stands out of the table, shape of the image, bool; widened by `margin` pixels."""
    depth = image.depth
    h, w = depth.shape
    row, column = np.mgrid[:h, :w]
    design = np.stack([column / w, row / h, np.ones_like(depth)], axis=-1).reshape(-1, 3)
    flat, kept = depth.ravel(), depth.ravel() > np.median(depth) - 0.03
    for _ in range(PLANE_ROUNDS):
        plane = np.linalg.lstsq(design[kept][::7], flat[kept][::7], rcond=None)[0]
        kept = np.abs(flat - design @ plane) < PLANE_BAND_M
    mask = ((design @ plane).reshape(h, w) - depth > OUTSTANDING_M).astype(np.uint8)
    count, parts, sizes, _ = cv2.connectedComponentsWithStats(mask)
    for part in range(1, count):
        if sizes[part, cv2.CC_STAT_AREA] < SMALLEST_OBJECT_PX:
            mask[parts == part] = 0
    return cv2.dilate(mask, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)) > 0
