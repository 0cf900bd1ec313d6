"""The frames that wait for the grasp which will label them. A frame is kept when the tool has moved since the last one;
what is too old or too many when the fingers close is dropped, oldest first.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import MutableSequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.config import integer, number
from grasping.execution.grasp_watch import ObservedGrasp
from grasping.lab.dataset.episode import NONE_MM, NOWHERE, Episode, Metadata
from grasping.network.depth_image import Crop
from grasping.network.maps import Peak, highest, peaks
from grasping.network.networks import MapNetwork, infer
from grasping.pipeline.pipeline import PipelineSettings, maps_of
from grasping.pipeline.projection import project_grasp
from grasping.pipeline.view import GraspView

MAP_SIDE = 150  # rows and columns of the kept maps: half of the network's, which its smoothing by 5 px outweighs
LARGEST_MM = np.iinfo(np.uint16).max


class NetworkView(NamedTuple):
    """What is kept."""

    depth: np.ndarray  # shape (side, side), uint16 [mm], 0 = no reading
    maps: np.ndarray  # shape (4, MAP_SIDE, MAP_SIDE), float16: quality, cos, sin, width
    mean: float  # what was taken off the network's image [m]
    peak: Peak  # the best that the node ggcnn would find, or the highest pixel where it would find none


def look(network: MapNetwork, view: GraspView, settings: PipelineSettings) -> tuple[NetworkView, np.ndarray | None]:
    """Returns what is kept of a view, and GGCNN's own grasp before its camera, shape (4, 4) [m], None without a reading
    there. Raises ValueError if the network's output is not finite.
    """
    crop, image, s = view.image.crop, view.image, settings
    output = infer(network, image.input)
    if not np.isfinite(output).all():
        raise ValueError("the network's maps are not finite")
    small = cv2.resize(output.transpose(1, 2, 0), (MAP_SIDE, MAP_SIDE), interpolation=cv2.INTER_AREA)
    maps = maps_of(output, view, s)
    best = [] if s.threshold is None else peaks(maps, 1, s.distance, s.threshold)
    window = view.depth[crop.row : crop.row + crop.side, crop.column : crop.column + crop.side]
    peak = best[0] if best else highest(maps)
    kept = NetworkView(millimetres(window), small.transpose(2, 0, 1).astype(np.float16), image.mean, peak)
    own = project_grasp(peak, crop, len(image.input), view.depth, view.camera)
    return kept, None if own is None else own.T_camera_grasp


def millimetres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image [m] in whole millimetres, uint16, 0 where there is no reading or it is too far away."""
    with np.errstate(invalid="ignore"):
        whole = np.rint(1000.0 * depth)
        known = np.isfinite(whole) & (whole > 0.0) & (whole <= LARGEST_MM)
    return np.where(known, whole, NONE_MM).astype(np.uint16)


@dataclass(frozen=True)
class FrameBufferConfig:
    """Which frames are kept."""

    rate: float = number("Hz", above=0.0, high=30.0, doc="most frames a second")
    motion: float = number("m", low=0.0, high=1.0, doc="least motion of the tool between frames")
    longest: float = number(
        "s", above=0.0, high=3600.0, doc="frames older than that when the fingers close are dropped"
    )
    most_frames: int = integer("frames", low=1, high=2000, doc="of an episode; half a megabyte each in memory")
    hand_radius: float = number("m", low=0.0, high=2.0, doc="what is nearer to the tool's axis, and")
    hand_reach: float = number("m", low=-1.0, high=1.0, doc="not farther along it than this, may be hand or arm")


class KeptFrame(NamedTuple):
    """A frame without its label; the fields are those of `Episode`, one row each."""

    stamp: float
    depth: np.ndarray
    maps: np.ndarray
    mean: float
    peak: Peak
    T_base_camera: np.ndarray
    T_base_tool_measured: np.ndarray
    T_base_tool_desired: np.ndarray
    finger_angles: np.ndarray
    teleop_active: bool


class Optics(NamedTuple):
    """How frames were taken."""

    camera: CameraModel  # that sees what the network sees: a real or an imagined one
    crop: Crop  # of its image
    real: CameraModel  # the camera that took the depth images


class KeptFrames(NamedTuple):
    """The frames before a grasp, at least one, oldest first, and how they were taken."""

    optics: Optics
    rows: list[KeptFrame]

    def episode(
        self,
        grasp: ObservedGrasp,
        metadata: Metadata,
        T_flange_tool: np.ndarray,
        T_tool_grasp: np.ndarray,
        T_base_tool_shown: np.ndarray = NOWHERE,
        lift: float = math.nan,
    ) -> Episode:
        """Returns the frames with the grasp as their label, or with the tool that was shown, shape (4, 4) [m]; `lift`:
        probability that the proposal had."""
        return Episode(
            metadata=metadata,
            camera=self.optics.camera,
            crop=self.optics.crop,
            T_flange_tool=T_flange_tool,
            T_tool_grasp=T_tool_grasp,
            T_base_tool_closed=grasp.T_base_tool,
            T_base_tool_shown=T_base_tool_shown,
            t_grasp=grasp.time,
            held=grasp.held,
            lift=lift,
            **{name: np.array([getattr(row, name) for row in self.rows]) for name in KeptFrame._fields},
        )


def on_hand(p_base: np.ndarray, T_base_tool: np.ndarray, config: FrameBufferConfig) -> bool:
    """Returns whether a point, shape (3,) [m], may lie on the hand or the arm behind it, both in the base frame. If
    GGCNN's grasp does, it took the robot for an object: its map does not tell where an operator grasps.
    """
    x, y, z = T_base_tool[:3, :3].T @ (p_base - T_base_tool[:3, 3])
    return bool(z < config.hand_reach and np.hypot(x, y) < config.hand_radius)


class FrameBuffer:
    """The frames since the operator began."""

    def __init__(self, config: FrameBufferConfig) -> None:
        self._config = config
        self._frames: deque[KeptFrame] = deque(maxlen=config.most_frames)
        self._tried: float | None = None
        self._optics: Optics | None = None

    def __len__(self) -> int:
        return len(self._frames)

    def due(self, stamp: float) -> bool:
        """Returns whether an image of that time [s] may be looked at, after those before it."""
        if self._tried is not None and stamp - self._tried < 1.0 / self._config.rate:
            return False
        self._tried = stamp
        return True

    def wants(self, stamp: float, T_base_tool: np.ndarray) -> bool:
        """Returns whether a frame would be kept: it is newer than the last one, and the tool has moved."""
        if not self._frames:
            return True
        last = self._frames[-1]
        moved = np.linalg.norm(T_base_tool[:3, 3] - last.T_base_tool_measured[:3, 3])
        return stamp > last.stamp and bool(moved >= self._config.motion)

    def add(self, frame: KeptFrame, optics: Optics) -> bool:
        """Keeps a frame. Returns whether it had to drop those before it, because another camera took them."""
        changed = keep(self._frames, self._optics, frame, optics)
        self._optics = optics
        return changed

    def clear(self) -> None:
        """Drops all frames, and the memory of when an image was last looked at."""
        self._frames.clear()
        self._tried = None

    def take(self, until: float) -> KeptFrames | None:
        """Takes all frames out and returns those that may belong to a grasp at the time `until` [s]; None for none."""
        rows = [frame for frame in self._frames if until - self._config.longest <= frame.stamp <= until]
        self._frames.clear()
        return KeptFrames(self._optics, rows) if rows and self._optics is not None else None


def keep(rows: MutableSequence[KeptFrame], before: Optics | None, frame: KeptFrame, optics: Optics) -> bool:
    """Appends a frame to rows that were taken with the optics `before`; returns whether it had to drop them first."""
    changed = bool(rows) and before is not None and not same_optics(optics, before)
    if changed:
        rows.clear()
    rows.append(frame)
    return changed


def same_optics(a: Optics, b: Optics) -> bool:
    """Returns whether two frames were taken alike."""
    return a.crop == b.crop and _same_camera(a.camera, b.camera) and _same_camera(a.real, b.real)


def _same_camera(a: CameraModel, b: CameraModel) -> bool:
    equal = all(np.array_equal(getattr(a, key), getattr(b, key)) for key in "KDRP")
    return equal and (a.name, a.width, a.height) == (b.name, b.width, b.height)
