"""The marker board before a wall, as the rig's colour and infrared cameras see it, without errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from common.camera_model import from_calibration
from common.poses import inverse, pose
from common.rotations import rotation_about, rotation_from_zyx

CONFIG = Path(__file__).parents[1] / "config"


def load(name):
    """A yaml file of the package."""
    return yaml.safe_load((CONFIG / name).read_text())


RGB, DEPTH = (from_calibration(load(f"xtion_{name}.yaml")) for name in ("rgb", "depth"))
T_RGB_DEPTH = pose(rotation_from_zyx(0.004, -0.003, 0.005), (-0.027, 0.001, -0.002))
PLATE = 0.30
WALL_M = 3.0
RAYS = DEPTH.rays(np.stack(np.meshgrid(np.arange(DEPTH.width), np.arange(DEPTH.height)), axis=-1))


def board_pose(distance, tilt, towards=0.0, roll=0.0, x=0.0, y=0.0):
    """The marker board, tilted [deg] to one side from facing the camera, somewhere round the middle of the image."""
    towards, tilt, roll = np.radians([towards, tilt, roll])
    lean = rotation_about(2, towards) @ rotation_about(0, tilt) @ rotation_about(2, -towards)
    return pose(lean @ rotation_about(0, np.pi) @ rotation_about(2, roll), (x * distance, y * distance, distance))


def depth_image(T_rgb_board, plate=PLATE, noise=None):
    """The plate before a wall, as the infrared camera sees it [m]."""
    T = inverse(T_RGB_DEPTH) @ T_rgb_board
    n = T[:3, 2]
    z = (n @ T[:3, 3]) / (RAYS @ n)
    on_plate = np.abs((RAYS * z[..., None] - T[:3, 3]) @ T[:3, :2]).max(axis=-1) < plate / 2.0
    w = np.where(on_plate & (z > 0.0), 1.0 / np.where(z > 0.0, z, 1.0), 1.0 / WALL_M)
    if noise is not None:
        w = w + noise(w.shape)
    return (1.0 / w).astype(np.float32)
