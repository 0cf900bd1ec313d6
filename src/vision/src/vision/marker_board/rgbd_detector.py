"""From a colour and a depth picture to the poses of the panel: colour-only, plane and fused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from apriltag_ros.detector import Detection, TagDetector
from apriltag_ros.settings import DetectorSettings
from apriltag_ros.target import Target
from common.camera_model import CameraModel
from vision.marker_board.plane_fit import PlanePoseConfig
from vision.marker_board.plane_pose import DepthPose, depth_pose


@dataclass(frozen=True, eq=False)
class DepthDetection:
    """The panel in a pair of pictures.

    Attributes:
        colour: the detector's result.
        depth: its poses with depth.
    """

    colour: Detection
    depth: DepthPose


class DepthTagDetector:
    """Looks for one flat panel.

    Args:
        settings: of the detector.
        target: the tags on the panel.
        plate: edge of the square plate round the target's origin [m].
        config: of the pose with depth.

    Raises:
        ValueError: the tags do not lie in one plane with the plate.
    """

    def __init__(self, settings: DetectorSettings, target: Target, plate: float, config: PlanePoseConfig) -> None:
        if any(np.any(np.abs(tag.corners[:, 2]) > 1e-6) for tag in target.tags):
            raise ValueError(f"the tags of {target.name} do not lie in one plane with the plate, z = 0")
        self._detector = TagDetector(settings, (target,))
        self._rectified = settings.rectified
        self._plate, self._config = plate, config

    def detect(
        self,
        grey: np.ndarray,
        rgb: CameraModel,
        depth_picture: np.ndarray,
        depth: CameraModel,
        T_rgb_depth: np.ndarray,
        now: float,
    ) -> DepthDetection | None:
        """Returns the panel, or None if no tag of it is seen or its corners fit no pose.

        Args:
            grey: colour picture in grey, shape (height, width), uint8.
            rgb: its camera.
            depth_picture: raw, shape (height, width), float32 [m], NaN = none.
            depth: its camera.
            T_rgb_depth: pose of the depth camera in the colour camera, shape (4, 4) [m].
            now: when the pictures were taken [s].

        Raises:
            ValueError: a picture is not of its camera's size.
        """
        found = self._detector.detect(grey, rgb, now)
        if not found.targets:
            return None
        detection = found.targets[0]
        _, points, pixels = detection.target.matched({tag.id: tag.corners for tag in found.found})
        camera = rgb.rectified() if self._rectified else rgb
        T = detection.pose.T_camera_tag
        poses = depth_pose(T, points, pixels, camera, depth_picture, depth, T_rgb_depth, self._plate, self._config)
        return DepthDetection(detection, poses)
