"""The second network: GGCNN's maps in, the same maps after what a person was seen to do, and the rest of the pose.

A small network looks at GGCNN's maps and at heights above the table, and adds to the maps, pixel by pixel: where the
person would rather grasp, at which angle, how wide, how much deeper than the surface, and with which tilt. What the
person does always, like grasping a centimetre to the right, is a constant offset beside it. Untrained, both are zero,
and GGCNN's maps come back bit by bit.

The maps are those of the network's picture, before they are smoothed. Offset and tilt have the axes of the camera that
sees it, x right and y down: of the real one, or of the imagined one above the table. What was learned in one view is
wrong in the other, so a weight file names its view.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pinocchio as pin
import torch
import torch.nn.functional as F
from torch import nn

from common.poses import pose, read_only
from grasping import weights
from grasping.depth_image import Picture
from grasping.maps import Peak
from grasping.projection import Grasp
from grasping.quarter_turns import Features, FromMaps, ToMaps
from grasping.table_depth import table_depth
from grasping.view import VIEWS
from grasping.weights import WeightsError

SHRINK = 2
"""Pixels of the network's picture, in rows and in columns, to one of the second network's."""
COARSE = 2
"""Pixels of the second network's maps to one of its inner layers: a quarter of the work."""
SIGN, VECTOR = torch.tensor([[-1.0]]), torch.tensor([[0.0, 1.0], [-1.0, 0.0]])
SCALAR = -SIGN
INPUT_TURN = torch.block_diag(SCALAR, SIGN, SIGN, SCALAR, SCALAR)
"""How quality, cos, sin, width and height turn with the picture."""
OUTPUT_TURN = torch.block_diag(SCALAR, SIGN, SIGN, SCALAR, SCALAR, VECTOR)
"""How the changes of quality, cos, sin and width, the step along z and the tilt turn."""
INPUT_SCALE = (2.0, 1.0, 1.0, 4.0, 20.0)
OUTPUT_SCALE = (1.0, 1.0, 1.0, 0.25, 0.05, 0.2, 0.2)
"""Make all inputs and outputs about 1: widths are about 0.3, depths [m] and tilts [rad] small."""
FEATURES = 6
VIEW = "view"
"""Entry of a weight file beside the weights: place of the view's name in `view.VIEWS`."""
DILATIONS = (1, 2, 4, 8)


class Refined(NamedTuple):
    """GGCNN's maps after the second network.

    Attributes:
        output: quality, cos, sin, width as the first network gives them, shape (4, h, w).
        dz: how much deeper than the surface at the pixel the grasp is, along the optical axis, shape (h, w) [m].
        tilt_x: of the approach about the camera's x axis, shape (h, w) [rad].
        tilt_y: likewise about its y axis.
    """

    output: np.ndarray
    dz: np.ndarray
    tilt_x: np.ndarray
    tilt_y: np.ndarray


class RefinementNetwork(nn.Module):
    """The changes that the second network makes, without the constant offset.

    Attributes:
        offset: what the person adds wherever it is: x, y [px of the network's picture x m: divided by the distance it
            is a shift], tilt_x, tilt_y [rad], shape (4,).
    """

    def __init__(self, features: int = FEATURES) -> None:
        super().__init__()
        self.first = FromMaps(INPUT_TURN, features, 3)
        self.rest = nn.ModuleList(Features(features, features, dilation) for dilation in DILATIONS)
        self.last = ToMaps(features, OUTPUT_TURN)
        self.register_buffer("offset", torch.zeros(4))
        self.register_buffer("input_scale", torch.tensor(INPUT_SCALE)[:, None, None], persistent=False)
        self.register_buffer("output_scale", torch.tensor(OUTPUT_SCALE)[:, None, None], persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns the changes of quality, cos, sin and width, dz [m] and the tilt [rad], shape (n, 7, h, w).

        Args:
            x: GGCNN's maps and the height above the table [m], shape (n, 5, h, w), at a `SHRINK`th of their size.
        """
        # With the channels last a processor is three times as fast.
        x = F.relu(self.first((x * self.input_scale).contiguous(memory_format=torch.channels_last)))
        x = F.avg_pool2d(x, COARSE)
        for layer in self.rest:
            x = x + F.relu(layer(x))
        return F.interpolate(self.last(x) * self.output_scale, scale_factor=COARSE, mode="bilinear")


def inputs(output: np.ndarray, picture: Picture) -> np.ndarray:
    """Returns what the second network looks at, shape (5, h, w), float32.

    Args:
        output: of the first network, shape (4, h, w).
        picture: that it saw.
    """
    return np.concatenate([output, (table_depth(picture) - picture.depth)[None]]).astype(np.float32)


class Refinement:
    """The second network and how to use it.

    Attributes:
        view: in which it learned, a name in `view.VIEWS`; None where that is unknown.
    """

    def __init__(self, network: RefinementNetwork, view: str | None = None) -> None:
        self._network = network.eval()
        self.view = view

    def apply(self, output: np.ndarray, picture: Picture) -> Refined:
        """Returns GGCNN's maps refined.

        Args:
            output: of the first network, shape (4, h, w), float32; h and w are even.
            picture: that it saw.
        """
        maps = inputs(output, picture)
        with torch.no_grad():
            small = F.avg_pool2d(torch.from_numpy(maps)[None], SHRINK)
            change = F.interpolate(self._network(small), scale_factor=SHRINK, mode="bilinear")[0].numpy()
        x, y, tilt_x, tilt_y = self._network.offset.tolist()
        shift = x / picture.mean, y / picture.mean
        depth = picture.depth.astype(np.float32)
        moved = _moved(np.concatenate([output + change[:4], (depth + change[4])[None], change[5:]]), shift)
        # A shifted grasp keeps its depth, whatever is seen where it has come to.
        return Refined(moved[:4], moved[4] - depth, moved[5] + np.float32(tilt_x), moved[6] + np.float32(tilt_y))


def refined_grasp(grasp: Grasp, refined: Refined, peak: Peak) -> Grasp:
    """Returns a grasp of the refined maps with its depth and tilt.

    Args:
        grasp: as `projection.grasp` has it, on the surface along the optical axis.
        refined: the maps.
        peak: the pixel of the grasp in them.
    """
    at = peak.row, peak.column
    z = grasp.T_camera_grasp[2, 3]
    factor = 1.0 + float(refined.dz[at]) / z
    tilt = pin.exp3(np.array([refined.tilt_x[at], refined.tilt_y[at], 0.0], dtype=float))
    T = pose(tilt @ grasp.T_camera_grasp[:3, :3], factor * grasp.T_camera_grasp[:3, 3])
    return grasp._replace(T_camera_grasp=read_only(T), width=factor * grasp.width)


def load(data: bytes, sha256: str | None = None) -> Refinement:
    """Returns the refinement that a weight file holds: a torch state dict, read without running what is in it.

    Args:
        data: content of the file.
        sha256: what its hash must be, hexadecimal; not checked when left out.

    Raises:
        WeightsError: another hash, no torch file, not one of this network, or of an unknown view.
    """
    weights.checked_sha256(data, sha256)
    state = weights.torch_state(data)
    view = _view(state.pop(VIEW, None))
    features = len(state.get("first.weight", ())) or FEATURES
    return Refinement(weights.filled(RefinementNetwork(features), "the refinement network", state), view)


def content(network: RefinementNetwork, view: str) -> dict[str, torch.Tensor]:
    """Returns what a weight file holds: the network's weights, and the view in which they were learned."""
    return {**network.state_dict(), VIEW: torch.tensor(float(VIEWS.index(view)))}


def _view(entry: torch.Tensor | None) -> str | None:
    """Returns the view that an entry of a weight file means."""
    if entry is None:
        return None
    if entry.numel() != 1 or entry.item() not in range(len(VIEWS)):
        raise WeightsError("The weight file names no view that is known.")
    return VIEWS[int(entry)]


def _moved(maps: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Returns the maps, shape (k, h, w), shifted right and down [px]; the border's values are drawn out."""
    if shift == (0.0, 0.0):
        return maps
    forward = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    size = maps.shape[:0:-1]
    return np.stack([cv2.warpAffine(m, forward, size, borderMode=cv2.BORDER_REPLICATE) for m in maps])
