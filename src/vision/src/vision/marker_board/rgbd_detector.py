"""Detects the marker board in a pair of colour and depth images: colour-only, plane and fused pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from apriltag_ros.detector import TagDetector, TargetDetection
from apriltag_ros.settings import DetectorSettings
from apriltag_ros.target import TagTarget
from common.camera_model import CameraModel
from vision.marker_board.plane_fit import PlanePoseConfig
from vision.marker_board.plane_pose import RgbdPose, rgbd_pose


@dataclass(frozen=True, eq=False)
class RgbdDetection:
    """The marker board in a pair of images: the detector's result, and its poses with depth."""

    colour: TargetDetection
    depth: RgbdPose


class RgbdDetector:
    """Detects one flat marker board.

    Args:
        target: the tags on the marker board.
        plate: edge of the square plate round the target's origin [m].

    Raises:
        ValueError: the tags do not lie in the plane of the plate.
    """

    def __init__(self, settings: DetectorSettings, target: TagTarget, plate: float, config: PlanePoseConfig) -> None:
        if np.any(np.abs(target.corners[:, 2]) > 1e-6):
            raise ValueError(f"the tags of {target.name} do not lie in the plate, z = 0: correct tags.yaml")
        self._detector = TagDetector(settings, (target,))
        self._rectified = settings.rectified
        self._plate, self._config = plate, config

    def detect(
        self,
        grey: np.ndarray,
        rgb: CameraModel,
        depth_image: np.ndarray,
        depth: CameraModel,
        T_rgb_depth: np.ndarray,
        now: float,
    ) -> RgbdDetection | None:
        """Returns the marker board, or None if no tag of it is visible or its corners fit no pose.

        Args:
            grey: colour image in grey, shape (height, width), uint8.
            rgb, depth: the cameras.
            depth_image: raw, shape (height, width), float32 [m], NaN where unknown.
            T_rgb_depth: pose of the depth camera in the colour camera, shape (4, 4) [m].
            now: time stamp of the images [s].

        Raises:
            ValueError: an image does not have its camera's size.
        """
        result = self._detector.detect(grey, rgb, now)
        if not result.targets:
            return None
        detection = result.targets[0]
        _, points, pixels = detection.target.matched({tag.id: tag.corners for tag in result.tags})
        camera = rgb.rectified() if self._rectified else rgb
        T = detection.pose.T_camera_tag
        poses = rgbd_pose(T, points, pixels, camera, depth_image, depth, T_rgb_depth, self._plate, self._config)
        return RgbdDetection(detection, poses)
