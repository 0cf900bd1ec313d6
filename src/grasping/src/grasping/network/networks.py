"""GG-CNN and GG-CNN2 of Morrison, Corke and Leitner (RSS 2018; GG-CNN2 is the later, wider-sighted kind).

The layers have the names of the published files. For the CPU's sake the heads are one convolution, and GG-CNN's last
transposed convolutions are ordinary ones and a pixel shuffle; the outputs are the same to rounding. Input: shape (n, 1,
h, w), depth less its mean, in [-1, 1] [m]. Output: shape (n, 4, h, w), the maps `MAPS`: quality (about 0 to 1), cos and
sin of twice the grasp's angle, and the opening in units of `maps.WIDTH_SCALE_PX`.
"""

from __future__ import annotations

import warnings
from typing import Callable, NamedTuple, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from grasping.network.depth_image import NETWORK_SIDE

Network = TypeVar("Network", bound=nn.Module)
MapNetwork = Callable[[torch.Tensor], torch.Tensor]  # from images, shape (n, 1, h, w), to maps, shape (n, 4, h, w)
MAPS = ("quality", "cos", "sin", "width")
FLOAT32, BFLOAT16 = PRECISIONS = "float32", "bfloat16"  # of the convolutions; all else is float32
HEADS = ("pos_output", "cos_output", "sin_output", "width_output")


class Borders(NamedTuple):
    """How GG-CNN treats the border of the image; the weights belong to one of the two kinds."""

    conv: tuple[tuple[int, int], ...]  # rows and columns of zeros before and after the input of the three convolutions
    crop: tuple[int, int, int]  # first row and column kept of the three transposed convolutions' full outputs
    rest: int  # rows and columns kept of the last one beyond (stride x input size)
    head: tuple[int, int]  # zeros before and after the input of the heads


TORCH = Borders(conv=((3, 3), (2, 2), (1, 1)), crop=(1, 2, 3), rest=1, head=(0, 0))
"""The published torch network: symmetric padding."""
KERAS = Borders(conv=((3, 3), (1, 2), (0, 1)), crop=(0, 1, 3), rest=0, head=(0, 1))
"""The published Keras network: "same" padding of a 300 x 300 image, which is not symmetric."""


class GGCNN(nn.Module):
    """GG-CNN: 62,420 parameters; a pixel sees about 50 pixels around it. Sides must be multiples of 12."""

    side_multiple = 12

    def __init__(self, borders: Borders = TORCH) -> None:
        super().__init__()
        self.borders = borders
        self.conv1 = nn.Conv2d(1, 32, 9, stride=3)
        self.conv2 = nn.Conv2d(32, 16, 5, stride=2)
        self.conv3 = nn.Conv2d(16, 8, 3, stride=2)
        self.convt1 = nn.ConvTranspose2d(8, 8, 3, stride=2)
        self.convt2 = nn.ConvTranspose2d(8, 16, 5, stride=2)
        self.convt3 = nn.ConvTranspose2d(16, 32, 9, stride=3)
        for name in HEADS:
            self.add_module(name, nn.Conv2d(32, 1, 2))
        _initialise(self)

    def forward(self, depth: torch.Tensor) -> torch.Tensor:
        """Returns the maps, shape (n, 4, h, w)."""
        full = shuffled_transpose(self.features(depth), self.convt3.weight, self.convt3.bias)
        start, (rows, columns) = self.borders.crop[2], (n + self.borders.rest for n in depth.shape[2:])
        before, after = self.borders.head
        x = F.relu(full[:, :, start : start + rows, start : start + columns])
        return _heads(self, F.pad(x, (before, after, before, after)))

    def features(self, depth: torch.Tensor) -> torch.Tensor:
        """Returns the input of the last transposed convolution, shape (n, 16, h / 3, w / 3)."""
        check_side(depth, self.side_multiple)
        x = depth
        for layer, border in zip((self.conv1, self.conv2, self.conv3), self.borders.conv):
            x = bordered(layer, x, border)
        for transposed, start in zip((self.convt1, self.convt2), self.borders.crop):
            rows, columns = (2 * n for n in x.shape[2:])
            weight, bias = transposed.weight, transposed.bias
            # Torch is slow with this kernel and stride.
            full = shuffled_transpose(x, weight, bias, 2) if transposed is self.convt2 else transposed(x)
            x = F.relu(full[:, :, start : start + rows, start : start + columns])
        return x


class GGCNN2(nn.Module):
    """GG-CNN2: 66,676 parameters; a pixel sees about 139 pixels. Sides must be multiples of 4."""

    side_multiple = 4

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *_conv_relu(1, 16, 11),
            *_conv_relu(16, 16, 5),
            nn.MaxPool2d(2, 2),
            *_conv_relu(16, 16, 5),
            *_conv_relu(16, 16, 5),
            nn.MaxPool2d(2, 2),
            *_conv_relu(16, 32, 5, dilation=2),
            *_conv_relu(32, 32, 5, dilation=4),
            nn.UpsamplingBilinear2d(scale_factor=2),
            *_conv_relu(32, 16, 3),
            nn.UpsamplingBilinear2d(scale_factor=2),
            *_conv_relu(16, 16, 3),
        )
        for name in HEADS:
            self.add_module(name, nn.Conv2d(16, 1, 1))
        _initialise(self)

    def forward(self, depth: torch.Tensor) -> torch.Tensor:
        """Returns the maps, shape (n, 4, h, w)."""
        check_side(depth, self.side_multiple)
        return _heads(self, self.features(depth))


NETWORKS: dict[str, Callable[[], nn.Module]] = {"ggcnn": GGCNN, "ggcnn2": GGCNN2, "ggcnn_keras": lambda: GGCNN(KERAS)}
"""The known networks by name; `ggcnn_keras` is GG-CNN with the borders of the Keras weights."""


def infer(network: MapNetwork, image: np.ndarray) -> np.ndarray:
    """Returns the network's maps, shape (4, h, w), of a network image, shape (h, w)."""
    with torch.no_grad():
        return network(torch.from_numpy(image)[None, None])[0].float().contiguous().numpy()


def frozen(network: nn.Module, side: int = NETWORK_SIDE, precision: str = FLOAT32) -> MapNetwork:
    """Returns the network for evaluation only, its weights turned into constants, for one image of `side` rows and
    columns, in one of the `PRECISIONS`.
    """
    network = channels_last(network.eval())
    with torch.no_grad(), convolutions_in(precision), warnings.catch_warnings():
        # torch advises its compiler instead, which needs a C++ compiler at run time.
        warnings.simplefilter("ignore", DeprecationWarning)
        traced = torch.jit.trace(network, torch.zeros(1, 1, side, side))  # type: ignore[no-untyped-call]
        return torch.jit.freeze(traced)


def convolutions_in(precision: str) -> torch.autocast:
    """Returns the context in which torch evaluates convolutions and heads in one of the `PRECISIONS`."""
    # A trace would keep what the cache holds of weights.
    return torch.autocast("cpu", torch.bfloat16, enabled=precision == BFLOAT16, cache_enabled=False)


def channels_last(network: Network) -> Network:
    """Turns a network's weights into the order that a CPU is fastest with; returns the network."""
    network = network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in torch's types
    for module in network.modules():
        # With one input channel torch sees no difference and leaves the strides, which are slow without AVX-512.
        if isinstance(module, nn.Conv2d) and module.in_channels == 1:
            outputs, _, rows, columns = module.weight.shape
            module.weight.data = module.weight.data.as_strided(module.weight.shape, (rows * columns, 1, columns, 1))
    return network


def shuffled_transpose(
    x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor | None, stride: int = 3
) -> torch.Tensor:
    """Returns the transposed convolution, whose kernel is 9 x 9 or 5 x 5 and whose stride 3 or 2, by a convolution and
    a pixel shuffle. With stride s, output row s q + r is the sum over m = 0, 1, 2 of input row q - m times kernel row s
    m + r: for each remainder r a convolution with three taps. `x` (n, i, h, w), `weight` (i, o, k, k), `bias` (o,): (n,
    o, s h + k - s, s w + k - s).
    """
    i, o, k = weight.shape[:3]
    kernel = _remainders(weight, stride).permute(1, 2, 3, 0, 4, 5).reshape(stride * stride * o, i, 3, 3)
    bias = None if bias is None else bias.repeat_interleave(stride * stride)
    full = F.pixel_shuffle(F.conv2d(x, kernel, bias, padding=2), stride)
    rows, columns = (stride * size + k - stride for size in x.shape[2:])
    return full[:, :, :rows, :columns]


def check_side(depth: torch.Tensor, multiple: int) -> None:
    """Raises ValueError when a network would return maps of another size than the image's."""
    if torch.jit.is_tracing():  # type: ignore[attr-defined, no-untyped-call]
        return  # a trace is of one size, which was checked before
    h, w = depth.shape[2:]
    if h % multiple or w % multiple:
        raise ValueError(f"the image is {w} x {h}, but its sides must be multiples of {multiple}")


def bordered(layer: nn.Conv2d, x: torch.Tensor, border: tuple[int, int]) -> torch.Tensor:
    """Returns what a convolution and its ReLU make of the input with so many zeros before and behind it."""
    before, after = border
    if before == after:
        return F.relu(F.conv2d(x, layer.weight, layer.bias, layer.stride, before))
    return F.relu(layer(F.pad(x, (before, after, before, after))))


def _conv_relu(inputs: int, outputs: int, kernel: int, dilation: int = 1) -> tuple[nn.Module, nn.Module]:
    padding = dilation * (kernel // 2)
    return nn.Conv2d(inputs, outputs, kernel, padding=padding, dilation=dilation), nn.ReLU(inplace=True)


def _heads(network: nn.Module, x: torch.Tensor) -> torch.Tensor:
    """Returns what the four heads make of features, in one convolution."""
    heads = [getattr(network, name) for name in HEADS]
    return F.conv2d(x, torch.cat([h.weight for h in heads]), torch.cat([h.bias for h in heads]))


def _remainders(weight: torch.Tensor, stride: int) -> torch.Tensor:
    """Returns a transposed convolution's kernel, shape (i, o, k, k), as convolutions of its remainders: shape
    (i, o, stride, stride, 3, 3), the remainders of row and column, then the taps, reversed because a convolution
    correlates. The kernel is filled up with zeros to three taps.
    """
    i, o, k = weight.shape[:3]
    full = F.pad(weight, (0, 3 * stride - k) * 2)
    return full.reshape(i, o, 3, stride, 3, stride).flip(2, 4).permute(0, 1, 3, 5, 2, 4)


def _initialise(network: nn.Module) -> None:
    for module in network.modules():
        if isinstance(module, (nn.Conv2d, nn.ConvTranspose2d)):
            nn.init.xavier_uniform_(module.weight)
