"""Depth image in, grasps out: the chain of crop, network, smoothing, peaks and projection."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Callable, NamedTuple

import numpy as np
import torch
from torch import nn

from common.camera_model import CameraModel
from grasping.network.depth_image import CROP_SIDE, NETWORK_SIDE, NetworkImage, centre_crop, prepare
from grasping.network.maps import Maps, Peak, Smoothing, highest, peaks, smoothed
from grasping.network.refinement import MapRefiner, RefinedMaps
from grasping.pipeline.projection import CameraGrasp, grasp
from grasping.pipeline.refined_grasp import opened, refined_grasp

Network = Callable[[torch.Tensor], torch.Tensor]
"""From depth images, shape (n, 1, h, w), to maps, shape (n, 4, h, w)."""


@dataclass(frozen=True)
class PredictorSettings:
    """How to look for grasps.

    Attributes:
        crop_side: window of the camera's image [px].
        crop_rows_up: how far the window stands above the middle [px].
        smoothing: of the maps.
        count: most grasps to return; 1 is the highest pixel, whatever its quality.
        distance: between two peaks [px of the network's image].
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
        image: the network's.
        maps: smoothed.
        peaks: best first.
        grasps: one for each peak, None where the camera has no reading near it.
    """

    image: NetworkImage
    maps: Maps
    peaks: list[Peak]
    grasps: list[CameraGrasp | None]


class Predictor:
    """A network, a second one behind it where there is one, and how to use them."""

    def __init__(self, network: nn.Module, settings: PredictorSettings, refinement: MapRefiner | None = None) -> None:
        self.settings = settings
        self._network = frozen(network)
        self._refinement = refinement

    def predict(self, depth: np.ndarray, camera: CameraModel) -> Prediction:
        """Returns the grasps in a depth image.

        Args:
            depth: shape (h, w) [m], NaN where there is no reading.
            camera: that took it.

        Raises:
            ValueError: the crop does not fit the image, or holds no reading.
        """
        s = self.settings
        image = prepare(depth, centre_crop(depth.shape, s.crop_side, s.crop_rows_up))
        output = self.output(image)
        refined = self.refined(output, image)
        maps = smoothed(output if refined is None else refined.output, image.valid, s.smoothing)
        found = [highest(maps)] if s.count == 1 else peaks(maps, s.count, s.distance, s.threshold)
        if refined is not None:
            found = [opened(p, refined) for p in found]
        grasps = [grasp(p, image.crop, NETWORK_SIDE, depth, camera) for p in found]
        if refined is not None:
            grasps = [None if g is None else refined_grasp(g, refined, p) for g, p in zip(grasps, found)]
        return Prediction(image, maps, found, grasps)

    def output(self, image: NetworkImage) -> np.ndarray:
        """Returns the network's maps before they are smoothed, shape (4, h, w)."""
        return run(self._network, image.input)

    def refined(self, output: np.ndarray, image: NetworkImage) -> RefinedMaps | None:
        """Returns what the refinement network makes of the maps, None where there is none."""
        return None if self._refinement is None else self._refinement.apply(output, image)


def run(network: Network, image: np.ndarray) -> np.ndarray:
    """Returns the network's maps, shape (4, h, w), of an image, shape (h, w)."""
    with torch.no_grad():
        return network(torch.from_numpy(image)[None, None])[0].contiguous().numpy()


def frozen(network: nn.Module, side: int = NETWORK_SIDE) -> torch.jit.ScriptModule:
    """Returns the network traced for one image of `side` rows and columns, its weights turned into constants."""
    network = network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in torch's types
    with torch.no_grad(), warnings.catch_warnings():
        # torch advises its compiler instead, which needs a C++ compiler at run time.
        warnings.simplefilter("ignore", DeprecationWarning)
        traced = torch.jit.trace(network, torch.zeros(1, 1, side, side))  # type: ignore[no-untyped-call]
        return torch.jit.freeze(traced)
