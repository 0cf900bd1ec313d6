"""Detects all targets in a grey image and estimates their poses.

The detector remembers the last orientation of each target: it decides between two poses that fit equally well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from apriltag_ros.finder import TagDetection, TagFinder
from apriltag_ros.settings import DetectorSettings
from apriltag_ros.tag_pose import TagPose, tag_pose
from apriltag_ros.target import TagTarget, TargetTag
from common.camera_model import CameraModel

MEMORY_S = 0.5
"""Maximum age of the orientation that decides an ambiguity."""


@dataclass(frozen=True)
class TargetDetection:
    """A target in an image: its detected `tags` and its `pose` in the camera."""

    target: TagTarget
    tags: tuple[TargetTag, ...]
    pose: TagPose


@dataclass(frozen=True)
class DetectionResult:
    """All detections in an image."""

    targets: tuple[TargetDetection, ...]  # the targets with their poses
    tags: tuple[TagDetection, ...]  # every decoded tag, including those that belong to no target
    unknown: tuple[int, ...]  # ids of the tags that belong to no target
    failed: tuple[str, ...]  # one sentence for each target whose corners fit no pose


class TagDetector:
    """Detects `targets` in a sequence of images."""

    def __init__(self, settings: DetectorSettings, targets: tuple[TagTarget, ...]) -> None:
        self._settings = settings
        self._targets = targets
        self._finder = TagFinder(settings)
        self._known = {tag.id for target in targets for tag in target.tags}
        self.reset()

    def reset(self) -> None:
        """Forgets the poses of earlier images."""
        self._last: dict[str, tuple[float, np.ndarray]] = {}

    def detect(self, grey: np.ndarray, camera: CameraModel, now: float) -> DetectionResult:
        """Returns the detections in a grey image, shape (height, width), uint8, with the time stamp `now` [s].

        With the setting `rectified` the camera's rectified projection is used. Raises ValueError if the image does not
        have the camera's size, or is not grey.
        """
        if grey.shape != (camera.height, camera.width):
            raise ValueError(
                f"the image is {grey.shape[1]} x {grey.shape[0]}, but camera_info says {camera.width} x "
                f"{camera.height}: use the camera_info of this image topic"
            )
        if self._settings.rectified:
            camera = camera.rectified()
        tags = self._finder.find(grey)
        corners = {tag.id: tag.corners for tag in tags}
        detections, failed = [], []
        for target in self._targets:
            matched, points, pixels = target.matched(corners)
            if not matched:
                continue
            try:
                pose = tag_pose(points, pixels, camera, self._hint(target.name, now))
            except ValueError as error:
                failed.append(f"{target.name}: {error}")
                continue
            self._last[target.name] = (now, pose.T_camera_tag[:3, :3])
            detections.append(TargetDetection(target, matched, pose))
        unknown = tuple(sorted({tag.id for tag in tags} - self._known))
        return DetectionResult(tuple(detections), tags, unknown, tuple(failed))

    def _hint(self, name: str, now: float) -> np.ndarray | None:
        then, R = self._last.get(name, (-np.inf, None))
        return R if 0.0 <= now - then < MEMORY_S else None
