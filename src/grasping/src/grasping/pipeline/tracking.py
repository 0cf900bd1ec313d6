"""Tracks grasps from image to image: averages the maps over time, recognises grasps again, filters their poses.

Poses are in a frame that does not move: the arm's base where the camera's pose in it is known, else the camera.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from common.config import integer, number
from common.poses import pose, read_only
from common.rotations import cross, unit
from grasping.poses.hypotheses import turned

EDGE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class AveragingConfig:
    """How maps are averaged over time."""

    weight: float = number(above=0.0, high=1.0, doc="of the newest maps; 1 = no averaging")
    step: float = number("m", above=0.0, high=1.0, doc="depth that changed by more is something that moved")
    share: float = number(low=0.0, high=1.0, doc="fraction of the image that may move before the average starts again")


class MapAverage:
    """The network's maps, averaged for as long as camera and scene stand still."""

    def __init__(self, config: AveragingConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        self._averages: tuple[np.ndarray, np.ndarray] | None = None

    def step(self, output: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, bool]:
        """Returns the average, shape (4, h, w), and whether it began anew. `output`: the network's maps, shape (4, h,
        w), whose angle is a sine and a cosine; `depth`: its image without holes, shape (h, w) [m].
        """
        averages = self._averages
        if averages is None or averages[0].shape != output.shape or self._moved(averages[1], depth):
            self._averages = output.copy(), depth.copy()
            return output.copy(), True
        average, _ = self._averages = self._mean(averages[0], output), self._mean(averages[1], depth)
        return average.copy(), False

    def _mean(self, average: np.ndarray, newest: np.ndarray) -> np.ndarray:
        w, rows = self._config.weight, (-1, newest.shape[-1])
        return cv2.addWeighted(newest.reshape(rows), w, average.reshape(rows), 1.0 - w, 0.0).reshape(newest.shape)

    def _moved(self, average: np.ndarray, depth: np.ndarray) -> bool:
        """Returns whether more than edges, which flicker, differ from the averaged depth."""
        differs = cv2.absdiff(depth, average) > self._config.step
        return np.count_nonzero(cv2.erode(differs.view(np.uint8), EDGE)) > self._config.share * depth.size


@dataclass(frozen=True)
class TrackingConfig:
    """How grasps are followed from image to image."""

    same_distance: float = number("m", above=0.0, high=0.5, doc="a grasp this near to an earlier one is the same")
    keep: float = number("s", low=0.0, high=10.0, doc="a grasp not seen for longer is forgotten")
    better: float = number(low=0.0, high=1.0, doc="quality by which a rival must lead")
    frames: int = integer(low=1, high=100, doc="images in a row in which it must, to become the best")
    lost: float = number(low=0.0, high=1.0, doc="quality below which the best is given up at once")
    median: int = integer(low=1, high=25, doc="newest poses whose median is taken")
    time_constant: float = number("s", low=0.0, high=1.0, doc="of the exponential filter behind it; 0 = none")
    gate_distance: float = number("m", above=0.0, high=0.5, doc="a pose farther from the median is not believed, and")
    gate_angle: float = number("deg", above=0.0, high=90.0, doc="one turned by more is not either")
    gate_frames: int = integer(low=1, high=25, doc="until this many in a row agree with each other")


class GraspDetection(NamedTuple):
    """A grasp in one image."""

    T: np.ndarray  # its pose in the frame that does not move, shape (4, 4) [m]
    width: float  # opening [m]
    quality: float  # about 0 to 1


class TrackedGrasp(NamedTuple):
    """A grasp that was recognised."""

    id: int  # stays while the same grasp is seen again
    detection: int  # its number among the image's
    T: np.ndarray  # filtered pose, shape (4, 4) [m]
    width: float  # filtered opening [m]
    held: bool  # whether the newest pose was not believed


class GraspTracker:
    """Recognises grasps and keeps to the best one until a rival has been better for a while."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._next_id = 1
        self.reset()

    def reset(self) -> None:
        """Forgets all grasps; their numbers are not used again."""
        self._tracks: list[_Track] = []
        self._best: _Track | None = None
        self._rival: tuple[int, int] = (0, 0)

    def step(self, detections: Sequence[GraspDetection], now: float) -> list[TrackedGrasp]:
        """Returns the grasps of the newest image at `now` [s], the best first, the others by their quality. None while
        the best is out of sight and not yet forgotten: else the next best, maybe of another object, would replace it
        for single images.
        """
        owners = self._owners(detections)
        for track in self._tracks:
            track.in_sight = False
        for i, track in owners.items():
            track.see(detections[i], i, now)
        self._tracks = [t for t in self._tracks if now - t.last <= self._config.keep]
        seen = sorted(owners.values(), key=lambda t: -t.quality)
        self._choose(seen)
        if self.best_out_of_sight:
            return []
        return [t.tracked() for t in sorted(seen, key=lambda t: t is not self._best)]

    @property
    def best_out_of_sight(self) -> bool:
        """Whether the best grasp was not in the newest image, but is not forgotten yet."""
        return self._best is not None and not self._best.in_sight

    def _owners(self, detections: Sequence[GraspDetection]) -> dict[int, _Track]:
        """Returns the track of each detection: the most alike pairs first, a new track where none is near."""
        turn_m = 0.05  # a turn of 1 rad makes as unlike as this distance
        seen = np.array([d.T for d in detections]).reshape(-1, 1, 4, 4)
        known = np.array([t.T_seen for t in self._tracks]).reshape(1, -1, 4, 4)
        distances = np.linalg.norm((seen - known)[..., :3, 3], axis=2)
        unlike = distances + turn_m * turned(seen[..., :3, :3], known[..., :3, :3])
        near = np.argwhere(distances <= self._config.same_distance).tolist()
        pairs = sorted((unlike[i, k], i, k) for i, k in near)
        owners: dict[int, _Track] = {}
        taken: set[int] = set()
        for _, i, k in pairs:
            if i not in owners and k not in taken:
                owners[i] = self._tracks[k]
                taken.add(k)
        for i in range(len(detections)):
            if i not in owners:
                owners[i] = _Track(self._next_id, self._config)
                self._tracks.append(owners[i])
                self._next_id += 1
        return owners

    def _choose(self, seen: list[_Track]) -> None:
        """Lets the best grasp stay or change; a best one that is out of sight stays the best until it is forgotten."""
        if self._best not in self._tracks:
            self._best = None
        if not seen:
            return
        first = seen[0]
        if self._best is None or (self._best in seen and self._best.quality < self._config.lost):
            self._best, self._rival = first, (0, 0)
        elif (
            first is not self._best and self._best in seen and first.quality > self._best.quality + self._config.better
        ):
            count = self._rival[1] + 1 if self._rival[0] == first.id else 1
            self._rival = (first.id, count)
            if count >= self._config.frames:
                self._best, self._rival = first, (0, 0)
        else:
            self._rival = (0, 0)


class PoseFilter:
    """Median, then exponential filter, of position, finger line, approach and opening; jumps are not believed at once.
    The finger line turns about the approach without a direction: cosine and sine of twice its angle are filtered.
    """

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._accepted: deque[np.ndarray] = deque(maxlen=config.median)
        self._doubted: deque[np.ndarray] = deque(maxlen=config.gate_frames)
        self._state: np.ndarray | None = None
        self._time = 0.0
        self._axis = 0
        self.held = False

    def step(self, T: np.ndarray, width: float, now: float) -> tuple[np.ndarray, float]:
        """Returns the filtered pose, shape (4, 4) [m], and opening [m] after a pose and `width` [m] at `now` [s]."""
        # an approach nearer to the frame's axis, by this cosine, has its turns counted from another one
        aligned = 0.9
        if self._state is None or abs(T[self._axis, 2]) > aligned:
            self._accepted.clear()
            self._doubted.clear()
            self._state, self._axis = None, int(np.argmin(np.abs(T[:3, 2])))
        values = self._values(T, width)
        self.held = bool(self._accepted) and not self._near(values, self._accepted)
        if not self.held:
            self._doubted.clear()
            self._accepted.append(values)
        else:
            self._doubted.append(values)
            agree = all(self._near(v, self._doubted) for v in self._doubted)
            if len(self._doubted) == self._config.gate_frames and agree:
                self._accepted.clear()
                self._accepted.extend(self._doubted)
                self._doubted.clear()
                self._state, self.held = None, False
        middle = median(self._accepted)
        state = middle
        if self._state is not None:
            past = max(0.0, now - self._time)
            tau = self._config.time_constant
            state = self._state + (1.0 - math.exp(-past / tau) if tau > 0.0 else 1.0) * (middle - self._state)
        self._state, self._time = state, now
        return self._pose(state)

    def _values(self, T: np.ndarray, width: float) -> np.ndarray:
        """Returns x, y, z, cos 2 theta, sin 2 theta, approach, opening, shape (9,)."""
        e1, e2 = self._across(T[:3, 2])
        theta = math.atan2(T[:3, 0] @ e2, T[:3, 0] @ e1)
        return np.concatenate([T[:3, 3], (math.cos(2 * theta), math.sin(2 * theta)), T[:3, 2], (width,)])

    def _pose(self, values: np.ndarray) -> tuple[np.ndarray, float]:
        z = unit(values[5:8])
        e1, e2 = self._across(z)
        theta = 0.5 * math.atan2(values[4], values[3])
        x = math.cos(theta) * e1 + math.sin(theta) * e2
        return read_only(pose(np.column_stack([x, cross(z, x), z]), values[:3])), float(values[8])

    def _across(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns two directions across the approach; the first is as near as it can be to an axis of the frame."""
        e1 = unit(np.eye(3)[self._axis] - z[self._axis] * z)
        return e1, cross(z, e1)

    def _near(self, values: np.ndarray, others: Iterable[np.ndarray]) -> bool:
        """Returns whether a pose is within the gate of the median of others."""
        middle = median(others)
        far = math.dist(values[:3], middle[:3])
        turned = 0.5 * _between(values[3:5], middle[3:5])
        tilted = _between(values[5:8], middle[5:8])
        return bool(far <= self._config.gate_distance and max(turned, tilted) <= math.radians(self._config.gate_angle))


def median(values: Iterable[np.ndarray]) -> np.ndarray:
    """Returns the median of each component, shape (n,); np.median, made for large arrays, is slow."""
    ordered = np.sort(list(values), axis=0)
    middle = len(ordered) // 2
    return ordered[middle] if len(ordered) % 2 else 0.5 * (ordered[middle - 1] + ordered[middle])


def _between(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle between two vectors [rad]; a quarter turn where one of them has no direction."""
    norms = math.sqrt(float(a @ a) * float(b @ b))
    return math.acos(max(-1.0, min(1.0, float(a @ b) / norms))) if norms > 1e-9 else 0.5 * math.pi


class _Track:
    """One grasp and its filter."""

    def __init__(self, number: int, config: TrackingConfig) -> None:
        self.id = number
        self.in_sight = False
        self._filter = PoseFilter(config)

    def see(self, detection: GraspDetection, index: int, now: float) -> None:
        self._T, self._width = self._filter.step(detection.T, detection.width, now)
        self.T_seen = detection.T
        self.quality, self.last, self._index = detection.quality, now, index
        self.in_sight = True

    def tracked(self) -> TrackedGrasp:
        return TrackedGrasp(self.id, self._index, self._T, self._width, self._filter.held)
