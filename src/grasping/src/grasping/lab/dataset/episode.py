"""An episode of the dataset: what the camera and the network saw before an operator grasped something, and that grasp.

Each episode is one closing of the fingers. Its frames end there, and all of them bear the same label, known only in
hindsight: where the tool was when the fingers closed, and whether the hand then lifted something. Fixed in
`kuka/base_frame` it is expressed in each frame's camera by `labels.relative_label`. Frames of one episode are near
duplicates of each other: split training and test data by episode, never by frame.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.poses import inverse
from grasping.lab.dataset.opening import opening as hand_opening
from grasping.network.depth_image import CAMERA, Crop
from grasping.network.maps import Peak

NONE_MM = 0
"""What a depth image holds where the camera had no reading."""
FINGERS = ("index", "middle", "thumb", "spread")
"""Columns of `Episode.finger_angles`."""
EXECUTION, TELEOPERATION = "execution", "teleoperation"
"""Where an episode comes from: a proposal that the operator confirmed, or free teleoperation."""


@dataclass(frozen=True)
class Metadata:
    """The description of an episode beside its images."""

    version: str  # of the package that wrote the file
    revision: str  # of its source, empty where that is unknown
    date: str  # of the grasp, UTC, as year-month-dayThour:minute:secondZ
    operator: str  # who teleoperated
    object: str  # what was grasped
    source: str  # EXECUTION or TELEOPERATION
    reason: str  # one sentence, how it was seen whether the object was held
    configuration: Mapping[str, Any]  # of the rig; what `fingerprint` is made of

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the rig's configuration, hexadecimal: equal where robot, tool, camera, camera pose and
        network are equal."""
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
    """One closing of the fingers and the n frames before it, oldest first; arrays are read-only.

    Attributes:
        metadata: what was known beside the images.
        camera: that sees what the network sees: the real one, or an imagined one above the table (`view.TableView`);
            the label has its axes.
        crop: the window of its image that is kept.
        T_flange_tool: tool in the flange, shape (4, 4) [m].
        T_tool_grasp: grasp in the tool, shape (4, 4) [m]: z the approach, x through the fingers.
        T_base_tool_closed: measured tool when the fingers had closed, shape (4, 4) [m].
        t_grasp: when they had closed [s].
        held: whether the hand then held something while it was lifted. If not, the grasp teaches where not to grasp.
        stamp: of the depth images, shape (n,) [s], rising, none after t_grasp.
        depth: shape (n, side, side), uint16 [mm], 0 = no reading.
        maps: of the network before smoothing, shape (n, 4, m, m), float16: quality, cos, sin, width as the network
            has them; the mean of each block of 300 / m pixels.
        mean: what was taken off the network's image, shape (n,) [m].
        peak: GGCNN's own grasp, shape (n, 5): row, column, quality, angle, width as `maps.Peak` has them, in the
            network's 300 x 300 image.
        T_base_camera: optical frame of `camera`, shape (n, 4, 4) [m].
        T_base_tool_measured: tool by the measured joints, shape (n, 4, 4) [m].
        T_base_tool_desired: where the operator's hand wanted it, shape (n, 4, 4) [m]; NaN where no hand was followed.
        finger_angles: the grip's opening, shape (n, 4) [rad]: index, middle, thumb (0 = open), spread.
        teleop_active: whether an operator's hand was followed, shape (n,).
    """

    metadata: Metadata
    camera: CameraModel
    crop: Crop
    T_flange_tool: np.ndarray
    T_tool_grasp: np.ndarray
    T_base_tool_closed: np.ndarray
    t_grasp: float
    held: bool
    stamp: np.ndarray
    depth: np.ndarray
    maps: np.ndarray
    mean: np.ndarray
    peak: np.ndarray
    T_base_camera: np.ndarray
    T_base_tool_measured: np.ndarray
    T_base_tool_desired: np.ndarray
    finger_angles: np.ndarray
    teleop_active: np.ndarray

    def __len__(self) -> int:
        """Returns how many frames there are."""
        return len(self.stamp)

    @property
    def view(self) -> str:
        """Which view its images are of, a name in `view.VIEWS`; labels are in the axes of that view's camera."""
        return str(self.metadata.configuration.get("view", CAMERA))

    @property
    def T_base_grasp(self) -> np.ndarray:
        """The operator's grasp in `kuka/base_frame`, shape (4, 4) [m]: the label of every frame."""
        return self.T_base_tool_closed @ self.T_tool_grasp

    @property
    def opening(self) -> float:
        """How wide the hand was open in the last frame [m]; NaN where the fingers stood about nothing."""
        return hand_opening(self.finger_angles[-1])

    @property
    def distance(self) -> np.ndarray:
        """How far the tool still had to go to its grasp, shape (n,) [m]; where that is little, the hand hides the
        object from the camera, and GGCNN may take the hand for one."""
        return np.linalg.norm(self.T_base_tool_measured[:, :3, 3] - self.T_base_tool_closed[:3, 3], axis=1)

    def frame(self, i: int) -> EpisodeFrame:
        """Returns frame i."""
        row, column, *rest = self.peak[i].tolist()
        return EpisodeFrame(
            self.camera,
            self.crop,
            self.depth[i],
            self.maps[i],
            Peak(round(row), round(column), *rest),
            self.T_base_camera[i],
            self.T_base_grasp,
            self.opening,
        )

    def frames(self) -> list[EpisodeFrame]:
        """Returns all frames, oldest first."""
        return [self.frame(i) for i in range(len(self))]
