"""The operator's grasp against GGCNN's own, seen by the camera.

A grasp before the camera is a pixel, a depth along the optical axis, an angle in the image, and the tilt of its
approach, which GGCNN's does not have, against that axis. Its rotation is split as

    R_camera_grasp = exp(tilt) Rz(-angle),    tilt = (x, y, 0)

so that tilt is free of the hand's symmetry: half a turn about the approach keeps the tilt, and the angle modulo pi. If
the image turns about the optical axis, angle and tilt turn with it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.camera_model import CameraModel
from common.poses import read_only
from grasping.lab.dataset.episode import EpisodeFrame
from grasping.network.depth_image import NETWORK_SIDE, Crop
from grasping.network.maps import half_turn
from grasping.pipeline.projection import CameraGrasp, project_grasp


class RelativeLabel(NamedTuple):
    """An operator's grasp against GGCNN's."""

    row: float  # of the operator's grasp in the map; may lie outside [px of the map]
    column: float  # likewise
    row_shift: float  # that row less GGCNN's [px of the map]
    column_shift: float  # likewise
    depth: float  # of the operator's grasp along the optical axis, less GGCNN's [m]
    angle: float  # in the image, anticlockwise, less GGCNN's, in [-pi/2, pi/2) [rad]
    tilt: np.ndarray  # of the operator's approach about the camera's x and y axes, shape (2,) [rad]; GGCNN's is 0


def relative_label(frame: EpisodeFrame) -> RelativeLabel | None:
    """Returns the operator's grasp against GGCNN's own, in the pixels of the frame's maps. None if GGCNN's has no
    reading near its pixel, or the operator's is behind the camera or comes straight towards it.
    """
    own = own_grasp(frame)
    T = frame.T_camera_grasp
    if own is None or T[2, 3] <= 0.0:
        return None
    try:
        tilt, angle = tilt_and_angle(T[:3, :3])
    except ValueError:
        return None
    side = frame.maps.shape[-1]
    row, column = map_pixel(frame.camera.project(T[:3, 3]), frame.crop, side)
    # GGCNN's pixel is a whole one of the network's image, and generally none of a smaller map.
    own_row, own_column = ((i + 0.5) * side / NETWORK_SIDE - 0.5 for i in (frame.peak.row, frame.peak.column))
    shift, depth = (row - own_row, column - own_column), float(T[2, 3] - own.T_camera_grasp[2, 3])
    return RelativeLabel(row, column, *shift, depth, half_turn(angle - own.angle), read_only(tilt))


def own_grasp(frame: EpisodeFrame) -> CameraGrasp | None:
    """Returns GGCNN's own grasp before the camera, None where the camera has no reading near its pixel."""
    window = Crop(0, 0, frame.crop.side)
    return project_grasp(frame.peak, window, NETWORK_SIDE, frame.depth_m, windowed(frame.camera, frame.crop))


def windowed(camera: CameraModel, crop: Crop) -> CameraModel:
    """Returns the camera whose whole image is the window."""
    K, P = camera.K.copy(), camera.P.copy()
    K[:2, 2] -= (crop.column, crop.row)
    P[:2, 2] -= (crop.column, crop.row)
    return replace(camera, width=crop.side, height=crop.side, K=read_only(K), P=read_only(P))


def map_pixel(pixel: np.ndarray, crop: Crop, side: int) -> tuple[float, float]:
    """Returns row and column, in a map of `side` rows, of the camera's pixel u, v; undoes `projection.camera_pixel`."""
    u, v = (float(p) for p in pixel)
    scale = side / crop.side
    return (v - crop.row + 0.5) * scale - 0.5, (u - crop.column + 0.5) * scale - 0.5


def tilt_and_angle(R: np.ndarray) -> tuple[np.ndarray, float]:
    """Returns tilt, shape (2,) [rad], and angle [rad] of a grasp's rotation before the camera, shape (3, 3). Raises
    ValueError if the grasp approaches straight towards the camera, where the tilt may have any direction.
    """
    no_tilt_rad = 1e-9
    against_rad = 1e-6  # a grasp so near to one that comes from behind the object has no definite tilt
    x, y, z = R[:, 2]
    across = np.hypot(x, y)
    inclination = np.arctan2(across, z)
    if np.pi - inclination < against_rad:
        raise ValueError("a grasp that approaches straight towards the camera has no definite tilt")
    tilt = np.zeros(2) if inclination < no_tilt_rad else inclination / across * np.array([-y, x])
    turn = pin.exp3(np.append(tilt, 0.0)).T @ R
    return tilt, -float(np.arctan2(turn[1, 0], turn[0, 0]))
