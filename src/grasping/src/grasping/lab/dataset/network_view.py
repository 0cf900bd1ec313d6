"""The recorded part of a view: depth in whole millimetres, the network's maps before smoothing, GGCNN's own grasp."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch

from grasping.lab.dataset.episode import NONE_MM
from grasping.network.maps import Peak, highest, peaks
from grasping.network.networks import infer
from grasping.pipeline.pipeline import PipelineSettings, maps_of
from grasping.pipeline.projection import project_grasp
from grasping.pipeline.view import GraspView

MAP_SIDE = 150
"""Rows and columns of the kept maps: half of the network's, which its smoothing by 5 px outweighs."""
LARGEST_MM = np.iinfo(np.uint16).max


class NetworkView(NamedTuple):
    """What is kept."""

    depth: np.ndarray  # shape (side, side), uint16 [mm], 0 = no reading
    maps: np.ndarray  # shape (4, MAP_SIDE, MAP_SIDE), float16: quality, cos, sin, width
    mean: float  # what was taken off the network's image [m]
    peak: Peak  # the best that the node ggcnn would find, or the highest pixel where it would find none


def look(
    network: torch.jit.ScriptModule, view: GraspView, settings: PipelineSettings
) -> tuple[NetworkView, np.ndarray | None]:
    """Returns what is kept of a view, and GGCNN's own grasp before its camera, shape (4, 4) [m], None where it has no
    place for want of a reading.

    Raises:
        ValueError: the network says something that is not finite.
    """
    crop, image = view.image.crop, view.image
    output = infer(network, image.input)
    if not np.isfinite(output).all():
        raise ValueError("the network's maps are not finite")
    small = cv2.resize(output.transpose(1, 2, 0), (MAP_SIDE, MAP_SIDE), interpolation=cv2.INTER_AREA)
    maps = maps_of(output, view, settings)
    s = settings
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
