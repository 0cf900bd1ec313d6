"""From a grey picture to the poses of all targets in it; remembers the poses to decide between two that fit equally."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from apriltag_ros.finder import FoundTag, TagFinder
from apriltag_ros.settings import DetectorSettings
from apriltag_ros.tag_pose import TagPose, tag_pose
from apriltag_ros.target import TagPlace, Target
from common.camera_model import CameraModel

MEMORY_S = 0.5
"""A pose older than this says nothing about the present one."""


@dataclass(frozen=True)
class Detection:
    """A target in a picture.

    Attributes:
        target: which.
        tags: those of its tags that were seen.
        pose: in the camera.
    """

    target: Target
    tags: tuple[TagPlace, ...]
    pose: TagPose


@dataclass(frozen=True)
class Detections:
    """What a picture shows.

    Attributes:
        targets: with their poses.
        found: every tag, also those that belong to no target.
        unknown: ids of tags that belong to no target.
        failed: a sentence for each target whose corners fit no pose.
    """

    targets: tuple[Detection, ...]
    found: tuple[FoundTag, ...]
    unknown: tuple[int, ...]
    failed: tuple[str, ...]


class TagDetector:
    """Looks for `targets` in one picture after the other."""

    def __init__(self, settings: DetectorSettings, targets: tuple[Target, ...]) -> None:
        self._settings = settings
        self._targets = targets
        self._finder = TagFinder(settings)
        self._known = {tag.id for target in targets for tag in target.tags}
        self.reset()

    def reset(self) -> None:
        """Forgets the poses of before."""
        self._last: dict[str, tuple[float, np.ndarray]] = {}

    def detect(self, grey: np.ndarray, camera: CameraModel, now: float) -> Detections:
        """Returns what a picture shows.

        Args:
            grey: picture, shape (height, width), uint8.
            camera: that took it; where the settings say that pictures are rectified, its rectified projection counts.
            now: when it was taken [s].

        Raises:
            ValueError: the picture is not of the camera's size, or not grey.
        """
        if grey.shape != (camera.height, camera.width):
            raise ValueError(
                f"the picture is {grey.shape[1]} x {grey.shape[0]}, but the camera's {camera.width} x {camera.height}"
            )
        if self._settings.rectified:
            camera = camera.rectified()
        found = self._finder.find(grey)
        seen = {tag.id: tag.corners for tag in found}
        detections, failed = [], []
        for target in self._targets:
            tags, points, pixels = target.matched(seen)
            if not tags:
                continue
            try:
                pose = tag_pose(points, pixels, camera, self._hint(target.name, now))
            except ValueError as error:
                failed.append(f"{target.name}: {error}")
                continue
            self._last[target.name] = (now, pose.T_camera_tag[:3, :3])
            detections.append(Detection(target, tags, pose))
        unknown = tuple(sorted({tag.id for tag in found} - self._known))
        return Detections(tuple(detections), found, unknown, tuple(failed))

    def _hint(self, name: str, now: float) -> np.ndarray | None:
        then, R = self._last.get(name, (-np.inf, None))
        return R if 0.0 <= now - then < MEMORY_S else None
