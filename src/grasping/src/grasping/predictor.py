"""Depth picture in, grasps out: the chain of crop, network, smoothing, peaks and projection."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from common.camera_model import CameraModel
from grasping.depth_image import CROP_SIDE, NETWORK_SIDE, Picture, centre_crop, prepare
from grasping.maps import Maps, Peak, Smoothing, highest, peaks, smoothed
from grasping.projection import Grasp, grasp


@dataclass(frozen=True)
class PredictorSettings:
    """How to look for grasps.

    Attributes:
        crop_side: window of the camera's picture [px].
        crop_rows_up: how far the window stands above the middle [px].
        smoothing: of the maps.
        count: most grasps to return; 1 is the highest pixel, whatever its quality.
        distance: between two peaks [px of the network's picture].
        threshold: lowest quality of a peak where there are several.
    """

    crop_side: int = CROP_SIDE
    crop_rows_up: int = 0
    smoothing: Smoothing = field(default_factory=Smoothing)
    count: int = 1
    distance: int = 20
    threshold: float = 0.2


class Prediction(NamedTuple):
    """What was seen and found.

    Attributes:
        picture: the network's.
        maps: smoothed.
        peaks: best first.
        grasps: one for each peak, None where the camera has no reading near it.
    """

    picture: Picture
    maps: Maps
    peaks: list[Peak]
    grasps: list[Grasp | None]


class Predictor:
    """A network and how to use it."""

    def __init__(self, network: nn.Module, settings: PredictorSettings) -> None:
        self.settings = settings
        self._network = frozen(network)

    def predict(self, depth: np.ndarray, camera: CameraModel) -> Prediction:
        """Returns the grasps in a depth picture.

        Args:
            depth: shape (h, w) [m], NaN where there is no reading.
            camera: that took it.

        Raises:
            ValueError: the crop does not fit the picture, or holds no reading.
        """
        s = self.settings
        picture = prepare(depth, centre_crop(depth.shape, s.crop_side, s.crop_rows_up))
        maps = smoothed(run(self._network, picture.input), picture.valid, s.smoothing)
        found = [highest(maps)] if s.count == 1 else peaks(maps, s.count, s.distance, s.threshold)
        return Prediction(picture, maps, found, [grasp(p, picture.crop, NETWORK_SIDE, depth, camera) for p in found])


def run(network, picture: np.ndarray) -> np.ndarray:
    """Returns the network's maps, shape (4, h, w), of a picture, shape (h, w)."""
    with torch.no_grad():
        return network(torch.from_numpy(picture)[None, None])[0].contiguous().numpy()


def frozen(network: nn.Module, side: int = NETWORK_SIDE) -> torch.jit.ScriptModule:
    """Returns the network traced for one picture of `side` rows and columns, its weights turned into constants."""
    network = network.eval().to(memory_format=torch.channels_last)
    with torch.no_grad(), warnings.catch_warnings():
        # torch advises its compiler instead, which needs a C++ compiler at run time.
        warnings.simplefilter("ignore", DeprecationWarning)
        return torch.jit.freeze(torch.jit.trace(network, torch.zeros(1, 1, side, side)))
