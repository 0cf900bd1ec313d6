"""The frames of the RGB-D camera: the poses of its two cameras in camera_link, and their optical frames. camera_link
and the two camera frames: x forward, y left, z up. Optical frames: x right, y down, z forward. Each optical frame has
two names: the driver's, which the image headers carry, and camera/rgb_frame or camera/depth_frame."""

from __future__ import annotations

import dataclasses

import numpy as np

from common.config import flag, vector
from common.frames import CAMERA_LINK, DEPTH, DEPTH_ALIAS, DEPTH_OPTICAL, RGB, RGB_ALIAS, RGB_OPTICAL
from common.poses import inverse, pose

R_CAMERA_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclasses.dataclass(frozen=True)
class CameraFramesConfig:
    """The schema of camera_frames.yaml."""

    rgb: np.ndarray = vector(3, "m", low=-1.0, high=1.0, doc="colour camera in camera_link")
    depth: np.ndarray = vector(3, "m", low=-1.0, high=1.0, doc="infrared camera in camera_link")
    driver_frames: bool = flag(
        "true: publish all frames below camera_link; false: the driver does, and only our names are added", absent=True
    )


def camera_frames(config: CameraFramesConfig) -> list[tuple[str, str, np.ndarray]]:
    """Returns parent, child and the child's pose in the parent, shape (4, 4), of each frame to publish."""
    frames = []
    for sensor, optical, alias, position in (
        (RGB, RGB_OPTICAL, RGB_ALIAS, config.rgb),
        (DEPTH, DEPTH_OPTICAL, DEPTH_ALIAS, config.depth),
    ):
        if config.driver_frames:
            frames += [(CAMERA_LINK, sensor, pose(p=position)), (sensor, optical, pose(R_CAMERA_OPTICAL))]
        frames.append((optical, alias, pose()))
    return frames


def depth_in_rgb(config: CameraFramesConfig) -> np.ndarray:
    """Returns the pose of the depth camera's optical frame in that of the colour camera, shape (4, 4) [m]."""
    return inverse(pose(R_CAMERA_OPTICAL, config.rgb)) @ pose(R_CAMERA_OPTICAL, config.depth)
