"""An episode of the dataset: what the camera and the network saw before an operator grasped something, and that grasp.

Its frames share one label, known in hindsight: where the tool was when the fingers closed, and whether they held
something. They are near duplicates: split training and test data by episode, never by frame.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.poses import inverse, read_only
from grasping.network.depth_image import CAMERA, Crop
from grasping.network.maps import Peak

SWIVEL_M, KNUCKLE_M, THUMB_M = 0.0504, 0.01, 0.03
"""From the hand's base to the swivels of index and middle, from there to their knuckles, and from the base to the
thumb's knuckle, along the line on which they close (URDF of the hand)."""
DEPTH_M = 0.150 - 0.0816  # from the knuckles down to the grasp
NONE_MM = 0  # what a depth image holds where the camera had no reading
NOWHERE = read_only(np.full((4, 4), np.nan))  # stands for a pose that is not known
EXECUTION, TELEOPERATION, SHOWN = SOURCES = "execution", "teleoperation", "shown"
"""Of an episode: a confirmed proposal, free teleoperation, or a tool that an operator held at the grasp, unlifted."""


def hand_opening(angles: np.ndarray) -> float:
    """Returns the opening [m]; NaN where the fingers do not stand about something, or are not known. `angles`: shape
    (4,) [rad]: index, middle, thumb (0 = open), spread.
    """
    widest_m = 0.15  # fingers further apart are open to let go or to wave, not to grasp something: that says nothing
    index, middle, thumb, spread = (float(a) for a in angles)
    if not np.all(np.isfinite(angles)) or min(np.sin([index, middle, thumb])) <= 0.0:
        return float("nan")
    beside = KNUCKLE_M + DEPTH_M * 0.5 * (1.0 / np.tan(index) + 1.0 / np.tan(middle))
    found = SWIVEL_M + THUMB_M + np.cos(spread) * beside + DEPTH_M / np.tan(thumb)
    return float(found) if 0.0 < found < widest_m else float("nan")


def angles_of_opening(opening_m: float) -> np.ndarray:
    """Returns finger angles, shape (4,) [rad], that open the hand so far, all fingers alike."""
    finger = np.arctan2(2.0 * DEPTH_M, opening_m - SWIVEL_M - KNUCKLE_M - THUMB_M)
    return np.array([finger, finger, finger, 0.0])


def tool_of_label(T_base_tool_closed: np.ndarray, T_base_tool_shown: np.ndarray) -> np.ndarray:
    """Returns the tool at an episode's grasp: the desired one where it was shown, else the measured one."""
    return T_base_tool_closed if np.isnan(T_base_tool_shown).any() else T_base_tool_shown


@dataclass(frozen=True)
class Metadata:
    """The description of an episode beside its images."""

    version: str  # of the package that wrote the file
    revision: str  # of its source, empty where that is unknown
    date: str  # of the grasp, UTC, as year-month-dayThour:minute:secondZ
    operator: str  # who teleoperated
    object: str  # what was grasped
    source: str  # one of SOURCES
    reason: str  # one sentence, how it was seen whether the object was held
    configuration: Mapping[str, Any]  # of the rig; what `fingerprint` is made of

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the rig's configuration, hexadecimal; equal if robot, tool, camera, its pose and network are."""
        text = json.dumps(self.configuration, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


class EpisodeFrame(NamedTuple):
    """One frame of an episode."""

    camera: CameraModel  # that sees the image, real or imagined
    crop: Crop  # the window of its image that is kept
    depth: np.ndarray  # that window, shape (side, side), uint16 [mm], 0 = no reading
    maps: np.ndarray  # of the network before smoothing, shape (4, m, m), float16: quality, cos, sin, width
    peak: Peak  # GGCNN's own grasp, the best peak of the smoothed quality, in the network's 300 x 300 image
    T_base_camera: np.ndarray  # optical frame in `kuka/base_frame`, shape (4, 4) [m]
    T_base_grasp: np.ndarray  # the operator's grasp there, shape (4, 4) [m], as `projection.CameraGrasp` has its axes
    opening: float = float("nan")  # of the hand before it closed [m]; NaN where it is not known

    @property
    def depth_m(self) -> np.ndarray:
        """The window in metres, shape (side, side), float32, 0 = no reading: what `depth_image.prepare` takes."""
        return self.depth * np.float32(0.001)

    @property
    def T_camera_grasp(self) -> np.ndarray:
        """The operator's grasp before the camera, shape (4, 4) [m]."""
        return inverse(self.T_base_camera) @ self.T_base_grasp


@dataclass(frozen=True, eq=False)
class Episode:
    """One closing of the fingers and the n frames before it, oldest first; arrays are read-only."""

    metadata: Metadata  # what was known beside the images
    camera: CameraModel  # that sees the network's image, real or above the table (`TableView`); the label has its axes
    crop: Crop  # the window of its image that is kept
    T_flange_tool: np.ndarray  # tool in the flange, shape (4, 4) [m]
    T_tool_grasp: np.ndarray  # grasp in the tool, shape (4, 4) [m]: z the approach, x through the fingers
    T_base_tool_closed: np.ndarray  # measured tool when the fingers had closed, shape (4, 4) [m]
    t_grasp: float  # when they had closed [s]
    held: bool  # whether the hand then held something while it was lifted. If not, the grasp teaches where not to grasp
    stamp: np.ndarray  # of the depth images, shape (n,) [s], rising, none after t_grasp
    depth: np.ndarray  # shape (n, side, side), uint16 [mm], 0 = no reading
    maps: np.ndarray
    """Of the network before smoothing, shape (n, 4, m, m), float16: quality, cos, sin, width as the network has them;
    the mean of each block of 300 / m pixels."""
    mean: np.ndarray  # what was taken off the network's image, shape (n,) [m]
    peak: np.ndarray  # GGCNN's own grasp, shape (n, 5): `maps.Peak` in the network's 300 x 300 image
    T_base_camera: np.ndarray  # optical frame of `camera`, shape (n, 4, 4) [m]
    T_base_tool_measured: np.ndarray  # tool by the measured joints, shape (n, 4, 4) [m]
    T_base_tool_desired: np.ndarray  # as the operator's hand wanted it, shape (n, 4, 4) [m]; NaN: no hand followed
    finger_angles: np.ndarray  # the grip's opening, shape (n, 4) [rad]: index, middle, thumb (0 = open), spread
    teleop_active: np.ndarray  # whether an operator's hand was followed, shape (n,)
    T_base_tool_shown: np.ndarray = field(default_factory=lambda: NOWHERE)
    """Desired tool that an operator held at the grasp, shape (4, 4) [m]; NaN: the grasp was not shown, but made."""
    lift: float = float("nan")  # probability of a lift that the executed proposal had; NaN where none is known

    def __len__(self) -> int:
        return len(self.stamp)

    @property
    def view(self) -> str:
        """Which view its images are of, a name in `view.VIEWS`; labels are in the axes of that view's camera."""
        return str(self.metadata.configuration.get("view", CAMERA))

    @property
    def T_base_grasp(self) -> np.ndarray:
        """The operator's grasp in `kuka/base_frame`, shape (4, 4) [m]: the label of every frame."""
        return tool_of_label(self.T_base_tool_closed, self.T_base_tool_shown) @ self.T_tool_grasp

    @property
    def opening(self) -> float:
        """How wide the hand was open in the last frame [m]; NaN where the fingers stood about nothing."""
        return hand_opening(self.finger_angles[-1])

    @property
    def distance(self) -> np.ndarray:
        """Distance of the tool to its grasp, shape (n,) [m]; near it, the hand hides the object or passes for one."""
        return np.linalg.norm(self.T_base_tool_measured[:, :3, 3] - self.T_base_tool_closed[:3, 3], axis=1)

    def frame(self, i: int) -> EpisodeFrame:
        row, column, *rest = self.peak[i].tolist()
        peak, poses = Peak(round(row), round(column), *rest), (self.T_base_camera[i], self.T_base_grasp)
        return EpisodeFrame(self.camera, self.crop, self.depth[i], self.maps[i], peak, *poses, self.opening)

    def frames(self) -> list[EpisodeFrame]:
        """Returns all frames, oldest first."""
        return [self.frame(i) for i in range(len(self))]
