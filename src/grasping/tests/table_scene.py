"""Depth images of boxes on a table, by ray casting, for the tests of what looks at them."""

from __future__ import annotations

import numpy as np
import torch

from common.camera_model import CameraModel, pinhole
from common.poses import pose
from common.rotations import unit

CAMERA = pinhole("test", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
TABLE_HALF = np.array([0.5, 0.5, 0.015])
FLOOR_Z = -0.7
UP = np.array([0.0, 0.0, 1.0])


def looking_at(position, target) -> np.ndarray:
    """Returns T_base_camera of a camera at a place that looks at another, its x axis level."""
    z = unit(np.subtract(target, position))
    level = np.cross(z, UP)
    x = unit(level if np.linalg.norm(level) > 1e-3 else np.cross(z, (0.0, 1.0, 0.0)))
    return pose(np.column_stack([x, np.cross(z, x), z]), position)


def depth_picture(T_base_camera: np.ndarray, boxes, camera: CameraModel = CAMERA) -> np.ndarray:
    """Returns the depth, shape (h, w), float32 [m], of a table with its top at z = 0, boxes on it and a floor.

    Args:
        T_base_camera: shape (4, 4) [m].
        boxes: for each its centre x, y [m], turn about the vertical [rad] and edges x, y, z [m].
    """
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.stack((u, v), axis=-1)) @ T_base_camera[:3, :3].T
    start = T_base_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(rays[..., 2] < 0.0, (FLOOR_Z - start[2]) / rays[..., 2], np.inf)
    depth = np.minimum(depth, _box(start, rays, np.array([0.0, 0.0, -TABLE_HALF[2]]), 0.0, TABLE_HALF))
    for x, y, yaw, edges in boxes:
        half = 0.5 * np.asarray(edges)
        depth = np.minimum(depth, _box(start, rays, np.array([x, y, half[2]]), yaw, half))
    depth[~np.isfinite(depth)] = np.nan
    return depth.astype(np.float32)


def _box(start, rays, centre, yaw, half) -> np.ndarray:
    """Returns the depth of a box along each ray, inf where there is none."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    o, d = (start - centre) @ R, rays @ R
    with np.errstate(divide="ignore"):
        near, far = (-half - o) / d, (half - o) / d
    first, last = np.minimum(near, far).max(axis=-1), np.maximum(near, far).min(axis=-1)
    return np.where((first < last) & (first > 0.0), first, np.inf)


class Nearest(torch.nn.Module):
    """A network that calls good what is near, with an angle of 30 degrees and an opening of 45 pixels."""

    side_multiple = 1

    def forward(self, depth):
        one = torch.ones_like(depth)
        return torch.cat([-10.0 * depth, 0.5 * one, 0.8660254 * one, 0.3 * one], dim=1)
