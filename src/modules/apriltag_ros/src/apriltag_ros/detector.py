"""Detects tags in a grey image with the PyPI package `apriltag`, estimates the poses of all targets, and draws tags.

Corners have the convention of OpenCV and CameraInfo (the centre of the first pixel is 0, 0) and the order top left, top
right, bottom right, bottom left of the printed tag. The library counts from the corner of a pixel, half a pixel more.
Its pose estimates are not used, and its options refine_* and border have no effect. The detector remembers the last
orientation of each target: it decides between two poses that fit equally well.
"""

from __future__ import annotations

import multiprocessing
from dataclasses import dataclass

import apriltag
import cv2
import numpy as np

from apriltag_ros.settings import DetectorSettings, TagTarget, TargetTag
from apriltag_ros.tag_pose import TagPose, tag_pose
from common.camera_model import CameraModel
from common.poses import read_only

LIBRARY_OFFSET_PX = 0.5
OUTLINE_BGR, TOP_BGR = (0, 220, 0), (0, 0, 255)
SUBPIXEL_BITS = 4
MEMORY_S = 0.5
"""Maximum age of the orientation that decides an ambiguity."""


@dataclass(frozen=True, eq=False)
class TagDetection:
    """A tag in an image."""

    id: int  # number in the family
    corners: np.ndarray  # corners of the black square, shape (4, 2) [px]
    hamming: int  # number of corrected bits
    margin: float  # decision margin between black and white [grey levels]


class TagFinder:
    """Finds tags of one family. Create one finder per process: the library never frees a detector's memory. Raises
    ImportError if the module `apriltag` is not the PyPI package.
    """

    def __init__(self, settings: DetectorSettings) -> None:
        if not hasattr(apriltag, "DetectorOptions"):  # Debian's package has the same name and another interface
            raise ImportError(
                "the module apriltag is Debian's python3-apriltag, not PyPI's apriltag: source devel/setup.bash last, "
                "or run .venv/bin/pip install -r requirements.txt"
            )
        self._settings = settings
        options = apriltag.DetectorOptions(
            families=settings.tag_family,
            nthreads=settings.tag_threads or max(1, multiprocessing.cpu_count() - 1),
            quad_decimate=settings.tag_decimate,
            quad_blur=settings.tag_blur,
        )
        self._detector = apriltag.Detector(options)

    def find(self, grey: np.ndarray) -> tuple[TagDetection, ...]:
        """Returns the tags in a grey image, shape (height, width), uint8; raises ValueError for another shape or
        type.
        """
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise ValueError(
                f"the tag finder needs a grey image of uint8, shape (height, width), not {grey.dtype} {grey.shape}"
            )
        found = [
            TagDetection(tag.tag_id, read_only(tag.corners - LIBRARY_OFFSET_PX), tag.hamming, tag.decision_margin)
            for tag in self._detector.detect(np.ascontiguousarray(grey))
            if tag.hamming <= self._settings.max_hamming_dist
        ]
        if not self._settings.remove_duplicates:
            return tuple(found)
        ids = [tag.id for tag in found]
        return tuple(tag for tag in found if ids.count(tag.id) == 1)


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
        """Returns the detections in a grey image, shape (height, width), uint8, with the time stamp `now` [s]. With the
        setting `rectified` the camera's rectified projection is used. Raises ValueError if the image does not have the
        camera's size, or is not grey.
        """
        if grey.shape != (camera.height, camera.width):
            size = (
                f"the image is {grey.shape[1]} x {grey.shape[0]}, but camera_info says {camera.width} x {camera.height}"
            )
            raise ValueError(f"{size}: use the camera_info of this image topic")
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


def draw_tags(grey: np.ndarray, tags: tuple[TagDetection, ...]) -> np.ndarray:
    """Returns the image in BGR, shape (height, width, 3), with the tags outlined; top edges are red."""
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for tag in tags:
        points = np.rint(tag.corners * 2**SUBPIXEL_BITS).astype(np.int32)
        for i, (start, end) in enumerate(zip(points, np.roll(points, -1, axis=0))):
            colour = TOP_BGR if i == 0 else OUTLINE_BGR
            cv2.line(image, tuple(map(int, start)), tuple(map(int, end)), colour, 2, cv2.LINE_AA, SUBPIXEL_BITS)
        x, y = np.rint(tag.corners.mean(axis=0)).astype(int)
        cv2.putText(image, str(tag.id), (int(x) - 8, int(y) + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.7, TOP_BGR, 2)
    return image
