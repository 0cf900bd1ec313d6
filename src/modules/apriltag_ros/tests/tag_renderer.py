"""Images of tags with known truth: a pixel is the mean over many rays that meet the plane of the target.

The renderer shares no code with the detector: rays come from the camera model, patterns from the family's published
codes.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822)
"""tag36h11, ids 0 to 4: 36 bits, row by row from the top left, 1 = white."""

WHITE, BLACK, WALL = 200.0, 25.0, 90.0
SUB = 6
"""Rays along each edge of a pixel."""


@lru_cache(maxsize=None)
def cells(tag):
    """Returns the white cells of the black square of a tag, shape (8, 8), first row on top."""
    white = np.zeros((8, 8), dtype=bool)
    white[1:7, 1:7] = np.array([CODES[tag] >> (35 - i) & 1 for i in range(36)], dtype=bool).reshape(6, 6)
    return white


def render(camera, T_camera_target, tags, plate, blur=0.6, noise=2.0, seed=0):
    """Returns the image, shape (height, width), uint8.

    Args:
        camera: CameraModel, distortion included.
        T_camera_target: pose of the target, shape (4, 4) [m].
        tags: (id, size [m], x [m], y [m]) of each tag on the target's plane, upright.
        plate: edge of the white square plate round the origin [m].
        blur: sigma of the point spread [px]. noise: standard deviation [grey levels].
    """
    image = np.full((camera.height, camera.width), WALL)
    image += np.linspace(-15.0, 15.0, camera.width)
    edge = 0.5 * plate * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    outline = camera.project(edge @ T_camera_target[:3, :3].T + T_camera_target[:3, 3])
    u0, v0 = np.clip(np.floor(outline.min(0)).astype(int) - 2, 0, (camera.width, camera.height))
    u1, v1 = np.clip(np.ceil(outline.max(0)).astype(int) + 3, 0, (camera.width, camera.height))
    if u1 > u0 and v1 > v0:
        area = image[v0:v1, u0:u1]
        area[:] = _seen(camera, T_camera_target, tags, plate, u0, v0, area)
    if blur > 0.0:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image += np.random.default_rng(seed).normal(0.0, noise, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _seen(camera, T, tags, plate, u0, v0, wall):
    """Returns the mean over the rays of each pixel, shape (height, width); T^-1 ray is the point on the plate."""
    height, width = wall.shape
    u, v = np.meshgrid(np.arange(width + 1) + u0 - 0.5, np.arange(height + 1) + v0 - 0.5)
    met = (camera.rays(np.stack((u, v), axis=-1)) @ np.linalg.inv(T[:3, [0, 1, 3]]).T).astype(np.float32)
    patterns = [(cells(tag), size, cx, cy) for tag, size, cx, cy in tags]
    total = np.zeros(wall.shape)
    for a in (np.arange(SUB) + 0.5) / SUB:
        column = (1 - a) * met[:, :-1] + a * met[:, 1:]
        for b in (np.arange(SUB) + 0.5) / SUB:
            ray = (1 - b) * column[:-1] + b * column[1:]
            x, y = ray[..., 0] / ray[..., 2], ray[..., 1] / ray[..., 2]
            colour = np.where((np.abs(x) <= plate / 2) & (np.abs(y) <= plate / 2), WHITE, wall)
            for white, size, cx, cy in patterns:
                rows, columns = np.nonzero((np.abs(x - cx) < size / 2) & (np.abs(y - cy) < size / 2))
                row = np.minimum((4 - (y[rows, columns] - cy) / size * 8).astype(int), 7)
                column_of = np.minimum((4 + (x[rows, columns] - cx) / size * 8).astype(int), 7)
                black = ~white[row, column_of]
                colour[rows[black], columns[black]] = BLACK
            total += colour
    return total / SUB**2
