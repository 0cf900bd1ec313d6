"""What of the rig decides whether two episodes belong together; their fingerprint is made of it."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from common.camera_model import CameraModel
from common.poses import pose
from common.rotations import rotation_about
from grasping.network.depth_image import TABLE
from grasping.network.refinement_file import Origin
from grasping.pipeline.settings import GgcnnSettings
from grasping.pipeline.tool_pose import ToolPoseConfig

DIGITS = 3
"""Decimals of the camera pose: a millimetre and a milliradian; two live calibrations differ by more."""


def grasp_in_tool(settings: ToolPoseConfig) -> np.ndarray:
    """Returns T_tool_grasp, shape (4, 4) [m], of the hand on the tool: x through its fingers."""
    return pose(rotation_about(2, math.radians(settings.closing_angle)), settings.grip_in_tool)


def rig_configuration(
    kuka: dict[str, Any],
    T_flange_tool: np.ndarray,
    T_tool_grasp: np.ndarray,
    camera: CameraModel,
    T_base_camera: np.ndarray,
    settings: GgcnnSettings,
    weights: str,
) -> dict[str, Any]:
    """Returns the configuration as JSON can hold it.

    Args:
        kuka: the arm: robot, flange, mounting and file of calibrated parameters.
        T_flange_tool: shape (4, 4) [m].
        T_tool_grasp: shape (4, 4) [m].
        T_base_camera: where it stands, shape (4, 4) [m].
        weights: SHA-256 of the network's weight file.
    """
    # Adding 0 turns -0.0 into 0.0, which would be another text.
    return {
        "kuka": kuka,
        "T_flange_tool": T_flange_tool.tolist(),
        "camera": {
            "name": camera.name,
            "size": [camera.width, camera.height],
            **{key: getattr(camera, key).tolist() for key in "KDRP"},
        },
        "T_base_camera": (np.round(T_base_camera, DIGITS) + 0.0).tolist(),
        **_network_configuration(T_tool_grasp, settings, weights),
    }


def live_origin(settings: GgcnnSettings, weights: str, robot: str | None) -> Origin:
    """Returns what of this rig a refinement network depends on.

    Args:
        weights: SHA-256 of the first network's weight file.
        robot: which arm, None where that is not known.
    """
    found = _network_configuration(grasp_in_tool(settings.tool), settings, weights)
    return Origin.of({**found, "kuka": {"robot": robot}})


def _network_configuration(T_tool_grasp: np.ndarray, settings: GgcnnSettings, weights: str) -> dict[str, Any]:
    view = settings.main.view
    return {
        "T_tool_grasp": (np.round(T_tool_grasp, 9) + 0.0).tolist(),
        "view": view,
        "crop": asdict(settings.crop),
        "table": asdict(settings.table) if view == TABLE else None,
        "weights": weights,
    }
