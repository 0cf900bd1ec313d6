"""What the refinement network learns from: frames of an operator's episodes, and batches of them.

All maps are at the refinement network's scale, a `SHRINK`th of the first one's. Positions are in its pixels. Examples
are taken as they are: what the network looks at does not change when the image is turned or shifted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from grasping.lab.dataset.episode import EpisodeFrame
from grasping.lab.dataset.labels import RelativeLabel, map_pixel, relative_label, tilt_and_angle
from grasping.network.depth_image import NETWORK_SIDE, Crop, prepare, table_depth
from grasping.network.maps import WIDTH_SCALE_PX
from grasping.network.refinement import SHRINK, SIDE, features

SAME_PLACE_M = 0.04  # an operator's grasp further from GGCNN's was not meant to be the same
SIGMA_PX = 1.25  # of the target about the operator's pixel, 5 px of the network's image


class Example(NamedTuple):
    """A frame of an operator's episode."""

    features: np.ndarray  # as `refinement.features` has them, float16
    row: float  # of the operator's grasp; may lie outside
    column: float  # likewise
    height: float  # of the grasp above the table, along the optical axis [m]
    angle: float  # of the line through the fingers in the image, anticlockwise [rad]
    tilt_x: float  # of the approach about the camera's x axis [rad]
    tilt_y: float  # likewise about its y axis
    opening: float  # of the hand [GGCNN's unit x m]; NaN where it is not known
    held: bool  # whether the grasp held
    mean: float  # of the image's depth [m]


class OperatorOffset(NamedTuple):
    """What an operator adds to GGCNN's grasp wherever it is."""

    x: float = 0.0  # to the right, and
    y: float = 0.0  # down [px of the network's image x m: divided by the distance it is a shift]
    depth: float = 0.0  # along the optical axis [m]
    angle: float = 0.0  # in the image, anticlockwise [rad]
    tilt_x: float = 0.0  # of the approach [rad]
    tilt_y: float = 0.0  # likewise
    opening: float = 0.0  # of the hand [GGCNN's unit x m: divided by the distance it is GGCNN's unit]


def example(frame: EpisodeFrame, held: bool) -> Example | None:
    """Returns the example of a frame; None where the grasp cannot be seen by its camera, or the frame holds nothing."""
    T = frame.T_camera_grasp
    if T[2, 3] <= 0.0:
        return None
    try:
        image = prepare(frame.depth_m, Crop(0, 0, frame.crop.side))
        (tilt_x, tilt_y), angle = tilt_and_angle(T[:3, :3])
    except ValueError:
        return None
    row, column = map_pixel(frame.camera.project(T[:3, 3]), frame.crop, SIDE)
    near = tuple(int(np.clip(SHRINK * i, 0, NETWORK_SIDE - 1)) for i in (row, column))
    height = float(table_depth(image)[near] - T[2, 3])
    seen = features(frame.maps, image).astype(np.float16)
    opening = opening_units(frame) * image.mean / T[2, 3]
    return Example(seen, row, column, height, angle, float(tilt_x), float(tilt_y), opening, held, image.mean)


def constant_offset(frames: list[EpisodeFrame]) -> OperatorOffset:
    """Returns the median of what the operator added to GGCNN's grasps, where both meant about the same place."""
    shifts, turns, openings = [], [], []
    for frame in frames:
        label = relative_label(frame)
        if label is None:
            continue
        scale = NETWORK_SIDE / frame.maps.shape[-1]
        distance = frame.T_camera_grasp[2, 3]
        metres = np.hypot(label.row_shift, label.column_shift) * metres_per_pixel(frame)
        turns.append(label.tilt)
        if metres < SAME_PLACE_M:
            x, y = scale * distance * label.column_shift, scale * distance * label.row_shift
            shifts.append((x, y, label.depth, label.angle))
            openings.append(opening_units(frame) - distance * frame.peak.width / WIDTH_SCALE_PX)
    if not shifts:
        return OperatorOffset()
    known = [o for o in openings if np.isfinite(o)]
    wider = float(np.median(known)) if known else 0.0
    x, y, depth, angle = np.median(shifts, axis=0).tolist()
    tilt_x, tilt_y = np.median(turns, axis=0).tolist()
    return OperatorOffset(x, y, depth, angle, tilt_x, tilt_y, wider)


def opening_units(frame: EpisodeFrame) -> float:
    """Returns the opening of the operator's hand [GGCNN's unit x m]; NaN where it is not known."""
    return frame.opening * frame.camera.K[0, 0] * NETWORK_SIDE / frame.crop.side / WIDTH_SCALE_PX


def metres_per_pixel(frame: EpisodeFrame) -> float:
    """Returns how much a pixel of the frame's maps is at the operator's grasp [m]."""
    return float(frame.T_camera_grasp[2, 3] * frame.crop.side / frame.maps.shape[-1] / frame.camera.K[0, 0])


def offset_label(frame: EpisodeFrame, offset: OperatorOffset) -> RelativeLabel:
    """Returns GGCNN's grasp with the constant offset, as a label that `dataset.labels.pose_from_label` reads."""
    side = frame.maps.shape[-1]
    scale, distance = side / NETWORK_SIDE, float(np.median(frame.depth_m[frame.depth > 0]))
    row_shift, column_shift = scale * offset.y / distance, scale * offset.x / distance
    row, column = ((i + 0.5) * scale - 0.5 for i in (frame.peak.row, frame.peak.column))
    tilt = np.array([offset.tilt_x, offset.tilt_y])
    return RelativeLabel(
        row + row_shift, column + column_shift, row_shift, column_shift, offset.depth, offset.angle, tilt
    )


class RefinementTargets(NamedTuple):
    """What the refinement network should say of n images; the constant offset is taken off all."""

    place: torch.Tensor  # about the operator's pixel, sum 1, shape (n, SIDE, SIDE)
    held: torch.Tensor  # 1 where the operator's grasp held, 0 where it failed, shape (n,)
    height: torch.Tensor  # of the grasp above the table, along the optical axis, shape (n,) [m]
    cos: torch.Tensor  # of twice the angle of the line through the fingers, shape (n,)
    sin: torch.Tensor  # likewise
    tilt_x: torch.Tensor  # of the approach, shape (n,) [rad]
    tilt_y: torch.Tensor  # likewise
    opening: torch.Tensor  # of the hand, shape (n,) [GGCNN's unit x m]; NaN where it is not known

    def to(self, device: torch.device) -> RefinementTargets:
        """Returns the targets on a device."""
        return RefinementTargets(*(value.to(device) for value in self))


def batch(examples: list[Example], offset: OperatorOffset) -> tuple[torch.Tensor, RefinementTargets]:
    """Returns examples as the network's input, shape (n, features, SIDE, SIDE), and what it should say."""
    seen = torch.from_numpy(np.stack([np.float32(e.features) for e in examples]))
    places = torch.from_numpy(np.stack([place_target(*place(e, offset)) for e in examples]))
    rest = [
        (
            e.held,
            e.height + offset.depth,
            np.cos(2.0 * (e.angle - offset.angle)),
            np.sin(2.0 * (e.angle - offset.angle)),
            e.tilt_x - offset.tilt_x,
            e.tilt_y - offset.tilt_y,
            e.opening - offset.opening,
        )
        for e in examples
    ]
    return seen, RefinementTargets(places, *torch.tensor(rest, dtype=torch.float32).unbind(1))


def place(example: Example, offset: OperatorOffset) -> tuple[float, float]:
    """Returns row and column of the operator's grasp without the constant offset."""
    scale = SHRINK * example.mean
    return example.row - offset.y / scale, example.column - offset.x / scale


def place_target(row: float, column: float) -> np.ndarray:
    """Returns a bell of sum 1 about a pixel, shape (SIDE, SIDE), zeros where it lies outside."""
    at = np.arange(SIDE)
    bell = np.outer(*(np.exp(-0.5 * ((at - c) / SIGMA_PX) ** 2) for c in (row, column)))
    return (bell / max(float(bell.sum()), 1.0)).astype(np.float32)
