"""Detects tags in a grey image with the PyPI package `apriltag`, estimates the poses of all targets, and draws tags.

Corners have the convention of OpenCV and CameraInfo (the centre of the first pixel is 0, 0) and the order top left, top
right, bottom right, bottom left of the printed tag. The library counts from the corner of a pixel, half a pixel more.
Its pose estimates are not used, and its options refine_* and border have no effect. The detector remembers the last
orientation of each target: it decides between two poses that fit equally well."""

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

MEMORY_S = 0.5
"""Maximum age of the orientation that decides an ambiguity."""
LOOK_AGAIN_S = 10.0
"""Time between two looks for mirrored and inverted tags in images without tags."""
UNREADABLE = {
    "mirrored": "switch the mirroring of the camera's driver off",
    "with black and white exchanged": "print it with a black border on white paper",
}
"""How an image may show a tag that nobody can read, and what to do about it."""


@dataclass(frozen=True, eq=False)
class TagDetection:
    """A tag in an image."""

    id: int  # number in the family
    corners: np.ndarray  # corners of the black square, shape (4, 2) [px]
    hamming: int  # number of corrected bits
    margin: float  # decision margin between black and white [grey levels]


class TagFinder:
    """Finds tags of one family. Create one finder per process: the library never frees a detector's memory. Raises
    ImportError if the module `apriltag` is not the PyPI package."""

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
        self.left_out: dict[int, str] = {}  # why the last image's other tags do not count, by id

    def find(self, grey: np.ndarray) -> tuple[TagDetection, ...]:
        """Returns the tags that count in a grey image, shape (height, width), uint8; raises ValueError for another
        shape or type."""
        library_offset_px = 0.5
        # A tag with a corner nearer to the edge of the scaled image may go on outside: its corners are at the edge
        # then.
        edge_px = 2.0
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise ValueError(
                f"the tag finder needs a grey image of uint8, shape (height, width), not {grey.dtype} {grey.shape}"
            )
        found = [
            TagDetection(tag.tag_id, read_only(tag.corners - library_offset_px), tag.hamming, tag.decision_margin)
            for tag in self._detector.detect(np.ascontiguousarray(grey))
            if tag.hamming <= self._settings.max_hamming_dist
        ]
        first = edge_px * self._settings.tag_decimate
        last = np.array(grey.shape[::-1]) - 1.0 - first
        cut = {tag.id for tag in found if (tag.corners < first).any() or (tag.corners > last).any()}
        ids = [tag.id for tag in found]
        twice = {i for i in ids if self._settings.remove_duplicates and ids.count(i) > 1}
        self.left_out = {i: f"the tag {i} is at the image's edge and does not count: show the whole tag" for i in cut}
        self.left_out.update({i: f"the tag {i} is visible {ids.count(i)} times and does not count" for i in twice})
        return tuple(tag for tag in found if tag.id not in self.left_out)

    def unreadable(self, grey: np.ndarray) -> dict[int, str]:
        """Returns the tags that only a mirrored or an inverted image shows, by id, and what is to be done."""
        changed = zip((grey[:, ::-1], ~grey), UNREADABLE.items())
        return {
            tag.id: f"the tag {tag.id} is {how}: {cure}" for other, (how, cure) in changed for tag in self.find(other)
        }


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
    failed: tuple[str, ...]  # one sentence for each target whose corners fit no pose, and each known tag left out


class TagDetector:
    """Detects `targets` in a sequence of images."""

    def __init__(self, settings: DetectorSettings, targets: tuple[TagTarget, ...]) -> None:
        self._settings = settings
        self._targets = targets
        self._finder = TagFinder(settings)
        self._known = {tag.id for target in targets for tag in target.tags}
        self.reset()

    def reset(self) -> None:
        self._last: dict[str, tuple[float, np.ndarray]] = {}
        self._looked = -np.inf  # for mirrored and inverted tags [s]

    def detect(self, grey: np.ndarray, camera: CameraModel, now: float) -> DetectionResult:
        """Returns the detections in a grey image, shape (height, width), uint8, with the time stamp `now` [s]. With the
        setting `rectified` the camera's rectified projection is used. Raises ValueError if the image does not have the
        camera's size, or is not grey."""
        if grey.shape != (camera.height, camera.width):
            size = (
                f"the image is {grey.shape[1]} x {grey.shape[0]}, but camera_info says {camera.width} x {camera.height}"
            )
            raise ValueError(f"{size}: use the camera_info of this image topic")
        if self._settings.rectified:
            camera = camera.rectified()
        tags, left_out = self._finder.find(grey), self._finder.left_out
        if not tags and not left_out and not 0.0 <= now - self._looked < LOOK_AGAIN_S:
            self._looked, left_out = now, self._finder.unreadable(grey)
        detections, failed = [], [left_out[i] for i in sorted(self._known & left_out.keys())]
        for target in self._targets:
            seen = _occurrences(target, tags)
            for corners in seen:
                matched, points, pixels = target.matched(corners)
                hint = self._hint(target.name, now) if len(seen) == 1 else None
                try:
                    pose = tag_pose(points, pixels, camera, hint)
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


def _occurrences(target: TagTarget, tags: tuple[TagDetection, ...]) -> list[dict[int, np.ndarray]]:
    """Returns the corners by tag id of each time that the target is seen: a bundle once, a single tag perhaps twice."""
    own = [tag for tag in tags if tag.id in {member.id for member in target.tags}]
    if len(target.tags) == 1:
        return [{tag.id: tag.corners} for tag in own]
    return [{tag.id: tag.corners for tag in own}] if own else []


def draw_tags(grey: np.ndarray, tags: tuple[TagDetection, ...]) -> np.ndarray:
    """Returns the image in BGR, shape (height, width, 3), with the tags outlined; top edges are red."""
    outline_bgr = (0, 220, 0)
    top_bgr = (0, 0, 255)
    subpixel_bits = 4
    image = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    for tag in tags:
        points = np.rint(tag.corners * 2**subpixel_bits).astype(np.int32)
        for i, (start, end) in enumerate(zip(points, np.roll(points, -1, axis=0))):
            colour = top_bgr if i == 0 else outline_bgr
            cv2.line(image, tuple(map(int, start)), tuple(map(int, end)), colour, 2, cv2.LINE_AA, subpixel_bits)
        x, y = np.rint(tag.corners.mean(axis=0)).astype(int)
        cv2.putText(image, str(tag.id), (int(x) - 8, int(y) + 8), cv2.FONT_HERSHEY_SIMPLEX, 0.7, top_bgr, 2)
    return image
