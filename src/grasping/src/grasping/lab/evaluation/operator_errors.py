"""How far a predicted grasp is from an operator's, and simple predictors that the refinement network has to beat."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from common.poses import inverse
from common.rotations import rotation_about, rotation_angle
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import pose_from_label, relative_label
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare

NEAR_M, NEAR_RAD = 0.020, np.radians(15.0)
PATCH_SIDE = 120
"""Of the image's part about GGCNN's pixel by which frames are compared, in the network's image [px]."""
PATCH_CELLS = 24
HALF_TURN = rotation_about(2, np.pi)


class Miss(NamedTuple):
    """A predicted grasp against the operator's."""

    position: float  # distance [m]
    rotation: float  # angle between the orientations, half a turn about the approach being none [rad]

    @property
    def is_near(self) -> bool:
        """Whether both are within 20 mm and 15 degrees."""
        return self.position < NEAR_M and self.rotation < NEAR_RAD


def miss(T_wanted: np.ndarray, T_found: np.ndarray) -> Miss:
    """Returns how far a grasp, shape (4, 4) [m], is from the wanted one."""
    T = inverse(T_wanted) @ T_found
    return Miss(float(np.linalg.norm(T[:3, 3])), rotation_miss(T_wanted[:3, :3], T_found[:3, :3]))


def rotation_miss(R_wanted: np.ndarray, R_found: np.ndarray) -> float:
    """Returns the angle between orientations, shape (3, 3), half a turn about the approach being none [rad]."""
    R = R_wanted.T @ R_found
    return float(min(rotation_angle(R), rotation_angle(R @ HALF_TURN)))


class Neighbours:
    """Predicts what the operator did in the most similar frame: the nearest neighbour."""

    def __init__(self, frames: list[EpisodeFrame]) -> None:
        """Keeps frames, of which at least one has GGCNN's grasp and the operator's in sight, of grasps that held."""
        labelled = [(patch(frame), relative_label(frame)) for frame in frames]
        self._patches = np.stack([seen for seen, label in labelled if label is not None])
        self._labels = [label for _, label in labelled if label is not None]

    def grasp(self, frame: EpisodeFrame) -> np.ndarray:
        """Returns the pose before the camera, shape (4, 4) [m]."""
        nearest = int(np.argmin(np.square(self._patches - patch(frame)).sum(axis=1)))
        label = self._labels[nearest]
        scale = frame.maps.shape[-1] / NETWORK_SIDE
        row, column = ((i + 0.5) * scale - 0.5 for i in (frame.peak.row, frame.peak.column))
        return pose_from_label(frame, label._replace(row=row + label.row_shift, column=column + label.column_shift))


def patch(frame: EpisodeFrame) -> np.ndarray:
    """Returns what lies about GGCNN's pixel: depths less the pixel's, coarse, shape (PATCH_CELLS^2,) [m]."""
    depth = prepare(frame.depth_m, Crop(0, 0, frame.crop.side)).depth
    half = PATCH_SIDE // 2
    row, column = frame.peak.row + half, frame.peak.column + half
    bordered = cv2.copyMakeBorder(depth, half, half, half, half, cv2.BORDER_REPLICATE)
    window = bordered[row - half : row + half, column - half : column + half] - bordered[row, column]
    return cv2.resize(window, (PATCH_CELLS, PATCH_CELLS), interpolation=cv2.INTER_AREA).ravel()
