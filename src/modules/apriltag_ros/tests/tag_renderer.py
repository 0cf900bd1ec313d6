"""Pictures of tags with known truth: every pixel is the mean over many rays that are cut with the plane of the target.

It shares no code with the detector: rays come from the camera model, patterns from the family's published codes.
"""

from __future__ import annotations

import cv2
import numpy as np

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822)
"""tag36h11, ids 0 to 4: 36 bits, row by row from the top left, 1 = white."""

WHITE, BLACK, WALL = 200.0, 25.0, 90.0
SUB = 6
"""Rays along each edge of a pixel."""


def cells(tag):
    """Returns the white cells of the black square of a tag, shape (8, 8), first row on top."""
    white = np.zeros((8, 8), dtype=bool)
    white[1:7, 1:7] = np.array([CODES[tag] >> (35 - i) & 1 for i in range(36)], dtype=bool).reshape(6, 6)
    return white


def render(camera, T_camera_target, tags, plate, blur=0.6, noise=2.0, seed=0):
    """Returns the picture, shape (height, width), uint8.

    Args:
        camera: CameraModel, distortion included.
        T_camera_target: pose of the target, shape (4, 4) [m].
        tags: (id, size [m], x [m], y [m]) of each tag on the target's plane, upright.
        plate: edge of the white square plate round the origin [m].
        blur: sigma of the point spread [px]. noise: standard deviation [grey levels].
    """
    picture = np.full((camera.height, camera.width), WALL)
    picture += np.linspace(-15.0, 15.0, camera.width)
    edge = 0.5 * plate * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    outline = camera.project(edge @ T_camera_target[:3, :3].T + T_camera_target[:3, 3])
    u0, v0 = np.clip(np.floor(outline.min(0)).astype(int) - 2, 0, (camera.width, camera.height))
    u1, v1 = np.clip(np.ceil(outline.max(0)).astype(int) + 3, 0, (camera.width, camera.height))
    if u1 > u0 and v1 > v0:
        area = picture[v0:v1, u0:u1]
        area[:] = _seen(camera, T_camera_target, tags, plate, u0, v0, area)
    if blur > 0.0:
        picture = cv2.GaussianBlur(picture, (0, 0), blur)
    picture += np.random.default_rng(seed).normal(0.0, noise, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def _seen(camera, T, tags, plate, u0, v0, wall):
    height, width = wall.shape
    u, v = np.meshgrid(np.arange(width + 1) + u0 - 0.5, np.arange(height + 1) + v0 - 0.5)
    grid = camera.rays(np.stack((u, v), axis=-1))
    total = np.zeros(wall.shape)
    normal, origin = T[:3, 2], T[:3, 3]
    for a in (np.arange(SUB) + 0.5) / SUB:
        for b in (np.arange(SUB) + 0.5) / SUB:
            ray = (1 - b) * ((1 - a) * grid[:-1, :-1] + a * grid[:-1, 1:])
            ray = ray + b * ((1 - a) * grid[1:, :-1] + a * grid[1:, 1:])
            with np.errstate(divide="ignore", invalid="ignore"):
                points = ray * ((normal @ origin) / (ray @ normal))[..., None]
            x, y = (points - origin) @ T[:3, 0], (points - origin) @ T[:3, 1]
            colour = np.where((np.abs(x) <= plate / 2) & (np.abs(y) <= plate / 2), WHITE, wall)
            for tag, size, cx, cy in tags:
                column = np.floor((x - cx) / size * 8 + 4)
                row = np.floor(4 - (y - cy) / size * 8)
                inside = (column >= 0) & (column < 8) & (row >= 0) & (row < 8)
                white = cells(tag)[np.clip(row, 0, 7).astype(int), np.clip(column, 0, 7).astype(int)]
                colour = np.where(inside & ~white, BLACK, colour)
            total += colour
    return total / SUB**2
