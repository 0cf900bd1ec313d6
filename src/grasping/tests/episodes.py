"""Small episodes for tests."""

from __future__ import annotations

import numpy as np

from common.camera_model import pinhole
from common.poses import pose, read_only, translation
from common.rotations import rotation_about
from grasping.lab.dataset.episode import TELEOPERATION, Episode, Metadata
from grasping.network.depth_image import Crop

CAMERA = pinhole("camera", 640, 480, [[570.0, 0.0, 319.5], [0.0, 570.0, 239.5], [0.0, 0.0, 1.0]])
"""Its optical axis goes through the middle of its image."""
DOWN = pose(rotation_about(0, np.pi), (0.5, -0.4, 1.0))
"""A camera that looks straight down."""


def metadata(**changes) -> Metadata:
    values = {
        "version": "0.1.0",
        "revision": "",
        "date": "2026-01-02T03:04:05Z",
        "operator": "simulated operator",
        "object": "cup",
        "source": TELEOPERATION,
        "reason": "The thumb and a finger touched something while the tool was lifted by 30 mm.",
        "configuration": {"robot": "LBR7R800", "tool": [0.0, 0.106]},
    }
    return Metadata(**{**values, **changes})


CROP = Crop(40, 120, 400)


def episode(n: int = 3, crop: Crop = CROP, m: int = 150, depth_mm: int = 900, **changes) -> Episode:
    """An episode of a camera that looks down at a plain; the operator grasps a little beside GGCNN's pixel."""
    rng = np.random.default_rng(4)
    steps = np.arange(n, dtype=float)
    tools = np.stack([DOWN @ translation(0.1, 0.05, 0.5 + 0.01 * i) for i in range(n)])
    desired = tools.copy()
    desired[0] = np.nan
    values = {
        "metadata": metadata(),
        "camera": CAMERA,
        "crop": crop,
        "T_flange_tool": translation(0.0, 0.0, 0.106),
        "T_tool_grasp": translation(-0.0152, 0.0, 0.07),
        "T_base_tool_closed": DOWN @ translation(0.03, 0.02, depth_mm / 1000.0 - 0.09),
        "t_grasp": 100.0 + n,
        "held": True,
        "stamp": 100.0 + steps,
        "depth": np.full((n, crop.side, crop.side), depth_mm, np.uint16),
        "maps": rng.uniform(-1.0, 1.0, (n, 4, m, m)).astype(np.float16),
        "mean": np.full(n, depth_mm / 1000.0, np.float32),
        "peak": np.tile([140.0, 160.0, 0.7, 0.3, 40.0], (n, 1)),
        "T_base_camera": np.tile(DOWN, (n, 1, 1)),
        "T_base_tool_measured": tools,
        "T_base_tool_desired": desired,
        "finger_angles": np.zeros((n, 4), np.float32),
        "teleop_active": np.arange(n) > 0,
    }
    values.update(changes)
    for name in ("T_flange_tool", "T_tool_grasp", "T_base_tool_closed"):
        values[name] = read_only(values[name])
    return Episode(**values)
