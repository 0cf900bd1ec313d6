"""The refinement network: adapts GG-CNN's maps to what an operator did, and adds the rest of the pose.

A small network sees, pixel by pixel, GGCNN's quality and opening and the height above the table, here and in the
neighbourhood. It says how much more or less than GGCNN the operator likes to grasp there; how much deeper, turned and
wider open; how much the approach leans, about the axes of the image and with the surface; and how sure it is: a Laplace
distribution of depth, opening and lean, one of von Mises of twice the angle, as half a turn makes the same grasp, and
over the pixels a softmax of the quality. Untrained it gives GGCNN's maps back bit by bit. What the operator does
always, like grasping a centimetre to the right, is a constant offset beside it.
Turning or shifting the image changes nothing but the lean about its axes: an operator stays where they stand. The maps
are those of the network's image, before they are smoothed. Constant offset and lean have the axes of the camera that
sees it, x right and y down, real or imagined above the table: a weight file (`refinement_file`) names its view.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from grasping.network.depth_image import NETWORK_SIDE, NetworkImage, table_depth
from grasping.network.maps import WIDTH_SCALE_PX, gaussian

SHRINK = 4  # pixels of the network's image, in rows and in columns, to one of the refinement network's
SIDE = NETWORK_SIDE // SHRINK
LOWEST_M, HIGHEST_M = -0.01, 0.25  # heights beyond are holes badly filled, or the arm
QUALITY_BLURS, HEIGHT_BLURS = (1.25, 2.5), (1.25, 3.0, 6.0)  # standard deviations [px of its maps]; 1 px is about 7 mm
LEAN_BLUR = HEIGHT_BLURS.index(3.0)  # of the heights whose slope is the surface's
SLOPE_PX = 100.0  # about the refinement network's focal length [px]: turns differences of heights into slopes
REACH_PX = 15  # width of the neighbourhood whose highest point is looked at
HEIGHT = 1 + len(QUALITY_BLURS)  # place of the height among the features
FEATURE_SCALE = (*[1.0] * (1 + len(QUALITY_BLURS)), *[10.0] * (2 + len(HEIGHT_BLURS)), 2.0, 1.0)
"""Makes all that the network looks at about 1: heights [m] are small."""
OPENING = len(FEATURE_SCALE) - 2  # place of GGCNN's opening among the features
COS, SIN, LEAN_X, LEAN_Y = range(len(FEATURE_SCALE), len(FEATURE_SCALE) + 4)  # places behind the features: line, lean
CHANGES = {  # what the network says of a pixel, as `RefinementOutput` has it, and what makes it about 1
    "quality": 1.0,
    "depth": 0.05,
    "turn_cos": 3.0,
    "turn_sin": 3.0,
    "opening": 0.1,
    "tilt_x": 0.3,
    "tilt_y": 0.3,
    "follow": 0.5,
    "depth_scale": 1.0,
    "opening_scale": 1.0,
    "tilt_scale": 1.0,
}
CONCENTRATION = 4.0  # of twice the angle, in an untrained network
DEPTH_M, OPENING_UNITS, TILT_RAD = 0.01, 0.05, 0.1  # Laplace scales in an untrained network
SHARPNESS = 20.0  # logits of the softmax over the pixels by quality
LOBE_PX = 5  # grasps within this radius [px of the refinement network's image] count as one choice
HIDDEN = 32
AXES = ("x", "y", "depth", "angle", "tilt_x", "tilt_y", "opening")  # of the constant offset, units of `OperatorOffset`


class RefinementOutput(NamedTuple):
    """What the refinement network says of each pixel, without the constant offset; each shape (n, h, w)."""

    quality: torch.Tensor  # to be added to GGCNN's
    depth: torch.Tensor  # how much deeper than the surface [m]
    turn_cos: torch.Tensor  # with turn_sin: twice the turn from GGCNN's line, anticlockwise; length: concentration
    turn_sin: torch.Tensor  # likewise
    opening: torch.Tensor  # to be added to GGCNN's [its unit x m: divided by the distance it is GGCNN's unit]
    tilt_x: torch.Tensor  # of the approach about the camera's x axis [rad]
    tilt_y: torch.Tensor  # likewise about its y axis
    follow: torch.Tensor  # fraction of the surface's lean that is added to that
    depth_scale: torch.Tensor  # scale of the Laplace distribution of the depth [m]
    opening_scale: torch.Tensor  # of the opening [as opening]
    tilt_scale: torch.Tensor  # of the lean, whose density falls with its distance from the expected one [rad]

    @classmethod
    def of(cls, output: torch.Tensor) -> RefinementOutput:
        """Returns what the network's output, shape (n, len(CHANGES), h, w), means."""
        change = cls(*output.unbind(1))
        return change._replace(
            turn_cos=CONCENTRATION + change.turn_cos,
            depth_scale=DEPTH_M * torch.exp(change.depth_scale),
            opening_scale=OPENING_UNITS * torch.exp(change.opening_scale),
            tilt_scale=TILT_RAD * torch.exp(change.tilt_scale),
        )


class RefinedMaps(NamedTuple):
    """GGCNN's maps after the refinement network, each further one of shape (h, w)."""

    output: np.ndarray  # of GGCNN, shape (4, h, w): quality, cos, sin, width (the opening that the grasp needs)
    dz: np.ndarray  # how much deeper than the surface at the pixel the grasp is, along the optical axis [m]
    tilt_x: np.ndarray  # of the approach about the camera's x axis [rad]
    tilt_y: np.ndarray  # likewise about its y axis
    wider: np.ndarray  # how much wider than needed the operator opens the hand [px of the network's image]
    concentration: np.ndarray  # of twice the angle
    scales: np.ndarray  # scales of the Laplace distributions of depth [m], opening [px] and lean [rad], shape (3, h, w)


class RefinementNetwork(nn.Module):
    """The changes that the refinement network makes, without the constant offset."""

    offset: torch.Tensor  # what the operator adds wherever it is, shape (len(AXES),)
    feature_scale: torch.Tensor
    change_scale: torch.Tensor

    def __init__(self, hidden: int = HIDDEN) -> None:
        super().__init__()
        self.first = nn.Conv2d(len(FEATURE_SCALE), hidden, 1)
        self.second = nn.Conv2d(hidden, hidden, 1)
        self.last = nn.Conv2d(hidden, len(CHANGES), 1)
        for parameter in self.last.parameters():
            nn.init.zeros_(parameter)
        self.register_buffer("offset", torch.zeros(len(AXES)))
        self.register_buffer("feature_scale", torch.tensor(FEATURE_SCALE)[:, None, None], persistent=False)
        scale = torch.tensor(list(CHANGES.values()))
        self.register_buffer("change_scale", scale[:, None, None], persistent=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Returns what `RefinementOutput.of` reads, shape (n, len(CHANGES), h, w); `x`: as `features` has them, shape
        (n, LEAN_Y + 1, h, w); the last four are not looked at.
        """
        x = F.relu(self.first(x[:, : len(FEATURE_SCALE)] * self.feature_scale))
        return self.last(F.relu(self.second(x))) * self.change_scale

    def without_axes(self) -> dict[str, torch.Tensor]:
        """Returns the weights without what has the axes of a view: the constant offset, and the lean about them."""
        state = {name: value.detach().clone() for name, value in self.state_dict().items()}
        state["offset"].zero_()
        for i, name in enumerate(CHANGES):
            if name in ("tilt_x", "tilt_y"):
                state["last.weight"][i] = 0.0
                state["last.bias"][i] = 0.0
        return state


def features(output: np.ndarray, image: NetworkImage) -> np.ndarray:
    """Returns the network's features, first the quality, at `HEIGHT` the height above the table [m], and behind them
    GGCNN's line (cos and sin of twice its angle, length 1) and the surface's lean about the image's axes [rad, never a
    right angle]; shape (LEAN_Y + 1, SIDE, SIDE), float32. `output`: of GGCNN, shape (4, h, w), multiples of `SIDE`.
    """
    quality, cos, sin, width, height = (shrunk(m) for m in (*output, table_depth(image) - image.depth))
    height = np.clip(height, LOWEST_M, HIGHEST_M)
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (REACH_PX, REACH_PX))
    heights = [gaussian(height, s) for s in HEIGHT_BLURS]
    seen = [quality, *(gaussian(quality, s) for s in QUALITY_BLURS)]
    seen += [height, *heights, cv2.dilate(height, near)]
    length = np.hypot(cos, sin)
    line = np.maximum(length, np.float32(1e-6))
    slopes = np.gradient(heights[LEAN_BLUR] * np.float32(SLOPE_PX / image.mean))
    down, right = slopes / (np.float32(1.0) + np.hypot(*slopes))  # an edge is no slope to lean with
    # An opening in pixels times the distance is one in metres but for the focal length.
    return np.stack([*seen, width * np.float32(image.mean), length, cos / line, sin / line, -down, right])


class MapRefiner:
    """The refinement network and how to use it; `network` is that network."""

    def __init__(self, network: RefinementNetwork) -> None:
        self.network = network.eval()

    def apply(self, output: np.ndarray, image: NetworkImage) -> RefinedMaps:
        """Returns GGCNN's maps refined; `output`: of the first network, shape (4, 300, 300), float32."""
        seen = torch.from_numpy(features(output, image))[None]
        with torch.no_grad():
            said = RefinementOutput.of(self.network(seen))
            said = said._replace(
                tilt_x=said.tilt_x + said.follow * seen[:, LEAN_X], tilt_y=said.tilt_y + said.follow * seen[:, LEAN_Y]
            )
            large = F.interpolate(torch.stack(said, dim=1), scale_factor=SHRINK, mode="bilinear")[0].numpy()
            change = dict(zip(RefinementOutput._fields, large))
        x, y, deeper, angle, tilt_x, tilt_y, wider = self.network.offset.tolist()
        quality, cos, sin, width = output
        c, s = np.float32(np.cos(2.0 * angle)), np.float32(np.sin(2.0 * angle))
        concentration = np.hypot(change["turn_cos"], change["turn_sin"])
        length = np.maximum(concentration, np.float32(1e-6))
        u, v = change["turn_cos"] / length, change["turn_sin"] / length
        c, s = u * c - v * s, u * s + v * c
        to_px = np.float32(WIDTH_SCALE_PX / image.mean)
        depth = image.depth.astype(np.float32)
        rest = [depth + change["depth"], change["tilt_x"], change["tilt_y"], to_px * change["opening"], concentration]
        scales = [change["depth_scale"], to_px * change["opening_scale"], change["tilt_scale"]]
        maps = np.stack([quality + change["quality"], c * cos - s * sin, s * cos + c * sin, width, *rest, *scales])
        maps = _moved(maps, (x / image.mean, y / image.mean))
        # A shifted grasp keeps its depth, whatever is seen where it has come to.
        return RefinedMaps(
            maps[:4],
            maps[4] - depth + np.float32(deeper),
            maps[5] + np.float32(tilt_x),
            maps[6] + np.float32(tilt_y),
            maps[7] + to_px * np.float32(wider),
            maps[8],
            maps[9:],
        )


def shrunk(image: np.ndarray) -> np.ndarray:
    """Returns the mean of each block of pixels, shape (SIDE, SIDE), float32."""
    return cv2.resize(image.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA)


def _moved(maps: np.ndarray, shift: tuple[float, float]) -> np.ndarray:
    """Returns the maps, shape (k, h, w), shifted right and down [px]; the border's values are drawn out."""
    if shift == (0.0, 0.0):
        return maps
    forward = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    size = maps.shape[:0:-1]
    return np.stack([cv2.warpAffine(m, forward, size, borderMode=cv2.BORDER_REPLICATE) for m in maps])
