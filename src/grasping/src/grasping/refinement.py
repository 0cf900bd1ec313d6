"""The second network: GGCNN's maps in, the same maps after what a person was seen to do, and the rest of the pose.

A small network looks, pixel by pixel, at a few quantities that a person's choice may depend on: GGCNN's quality and
opening, and the height above the table, here and in the neighbourhood. It says how much more or less than GGCNN the
person likes to grasp there, and how much deeper than the surface. The quantities are the same however the picture is
turned or shifted, and so is what it says. What the person does always, like grasping a centimetre to the right, is a
constant offset beside it: of the place, the angle and the tilt. Untrained, all is zero, and GGCNN's maps come back bit
by bit.

The maps are those of the network's picture, before they are smoothed. Offset and tilt have the axes of the camera that
sees it, x right and y down: of the real one, or of the imagined one above the table. What was learned in one view is
wrong in the other, so a weight file names its view. One without an offset needs none.
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
from grasping.depth_image import NETWORK_SIDE, Picture
from grasping.maps import Peak, gaussian
from grasping.projection import Grasp
from grasping.table_depth import table_depth
from grasping.view import VIEWS
from grasping.weights import WeightsError

SHRINK = 4
"""Pixels of the network's picture, in rows and in columns, to one of the second network's."""
SIDE = NETWORK_SIDE // SHRINK
LOWEST_M, HIGHEST_M = -0.01, 0.25
"""Heights beyond are holes badly filled, or the arm."""
QUALITY_BLURS, HEIGHT_BLURS = (1.25, 2.5), (1.25, 3.0, 6.0)
"""Standard deviations of the neighbourhoods [px of the second network's maps]; one is about 7 mm."""
HEIGHT = 1 + len(QUALITY_BLURS)
"""Place of the height among the features."""
REACH_PX = 15
"""Width of the neighbourhood whose highest point is looked at."""
FEATURE_SCALE = (*[1.0] * (1 + len(QUALITY_BLURS)), *[10.0] * (2 + len(HEIGHT_BLURS)), 2.0, 1.0)
CHANGE_SCALE = (1.0, 0.05)
"""Make all that goes in and out about 1: heights and depths [m] are small."""
HIDDEN = 32
VIEW = "view"
"""Entry of a weight file beside the weights: place of the view's name in `view.VIEWS`."""


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
            is a shift], tilt_x, tilt_y, angle [rad], shape (5,).
    """

    offset: torch.Tensor
    feature_scale: torch.Tensor
    change_scale: torch.Tensor

    def __init__(self, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.first = nn.Conv2d(len(FEATURE_SCALE), hidden, 1)
        self.second = nn.Conv2d(hidden, hidden, 1)
        self.last = nn.Conv2d(hidden, len(CHANGE_SCALE), 1)
        for parameter in self.last.parameters():
            nn.init.zeros_(parameter)
        self.register_buffer("offset", torch.zeros(5))
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE)[:, None, None], persistent=False)
        self.register_buffer("change_scale", torch.tensor(CHANGE_SCALE)[:, None, None], persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns the change of the quality and dz [m], shape (n, 2, h, w).

        Args:
            x: as `features` has them, shape (n, len(FEATURE_SCALE), h, w).
        """
        x = F.relu(self.first(x * self.feature_scale))
        return self.last(F.relu(self.second(x))) * self.change_scale


def features(output: np.ndarray, picture: Picture) -> np.ndarray:
    """Returns what the second network looks at, shape (len(FEATURE_SCALE), SIDE, SIDE), float32; the quality is the
    first, the height above the table [m] stands at `HEIGHT`.

    Args:
        output: of the first network, shape (4, h, w); h and w are multiples of `SIDE`.
        picture: that it saw.
    """
    quality, cos, sin, width, height = (_shrunk(m) for m in (*output, table_depth(picture) - picture.depth))
    height = np.clip(height, LOWEST_M, HIGHEST_M)
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (REACH_PX, REACH_PX))
    seen = [quality, *(gaussian(quality, s) for s in QUALITY_BLURS)]
    seen += [height, *(gaussian(height, s) for s in HEIGHT_BLURS), cv2.dilate(height, near)]
    # An opening in pixels times the distance is one in metres but for the focal length.
    return np.stack([*seen, width * np.float32(picture.mean), np.hypot(cos, sin)])


class Refinement:
    """The second network and how to use it.

    Attributes:
        network: the second network.
        view: in which it learned, a name in `view.VIEWS`; None where that is unknown.
    """

    def __init__(self, network: RefinementNetwork, view: str | None = None) -> None:
        self.network = network.eval()
        self.view = view

    def fits(self, view: str) -> bool:
        """Returns whether it may be used in a view: the one in which it learned, or in any if it has no offset, which
        alone has axes."""
        return self.view == view or not self.network.offset.any()

    def apply(self, output: np.ndarray, picture: Picture) -> Refined:
        """Returns GGCNN's maps refined.

        Args:
            output: of the first network, shape (4, 300, 300), float32.
            picture: that it saw.
        """
        with torch.no_grad():
            change = self.network(torch.from_numpy(features(output, picture))[None])
            change = F.interpolate(change, scale_factor=SHRINK, mode="bilinear")[0].numpy()
        x, y, tilt_x, tilt_y, angle = self.network.offset.tolist()
        quality, cos, sin, width = output
        c, s = np.float32(np.cos(2.0 * angle)), np.float32(np.sin(2.0 * angle))
        depth = picture.depth.astype(np.float32)
        maps = np.stack([quality + change[0], c * cos - s * sin, s * cos + c * sin, width, depth + change[1]])
        maps = _moved(maps, (x / picture.mean, y / picture.mean))
        # A shifted grasp keeps its depth, whatever is seen where it has come to.
        tilts = (np.full_like(depth, tilt) for tilt in (tilt_x, tilt_y))
        return Refined(maps[:4], maps[4] - depth, *tilts)


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
    hidden = len(state.get("first.weight", ())) or HIDDEN
    return Refinement(weights.filled(RefinementNetwork(hidden), "the refinement network", state), view)


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


def _shrunk(picture: np.ndarray) -> np.ndarray:
    """Returns the mean of each block of pixels, shape (SIDE, SIDE), float32."""
    return cv2.resize(picture.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def _moved(maps: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Returns the maps, shape (k, h, w), shifted right and down [px]; the border's values are drawn out."""
    if shift == (0.0, 0.0):
        return maps
    forward = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    size = maps.shape[:0:-1]
    return np.stack([cv2.warpAffine(m, forward, size, borderMode=cv2.BORDER_REPLICATE) for m in maps])
