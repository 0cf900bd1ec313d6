"""The maps of GG-CNN and GG-CNN2 near the objects of a view from above the table, where the other pixels are not read.

The input of such a view is one constant beside its objects. What a layer makes of a constant depends only on the
distance from the image's border, so it is taken from a small constant image, and the first layers are evaluated only
as far as the objects reach. The last ones are evaluated only where the wanted maps read them; these are the plain
network's to rounding.
A layer is evaluated in strips (strips.py). Arrays of features have the channels last, shape (h, w, c), and are float32:
in bfloat16 the convolutions and heads alone are evaluated, and what is between them is exact.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from grasping.network.maps import blocks, enlarged, near
from grasping.network.networks import (
    FLOAT32,
    GGCNN,
    GGCNN2,
    ShuffledHeads,
    bordered,
    channels_last,
    convolutions_in,
    stacked_heads,
)
from grasping.network.strips import array, put, side_by_side, strips, tensor, with_margin

ROWS = 8  # of a strip of features
SMALL_SIDE = 30  # of GG-CNN's constant image; the border reaches 2 of its 5 pixels of a sixth of the size
CONSTANT_SIDE = 36  # of GG-CNN2's constant image; the border reaches 4 of its 9 quarter-size pixels from each side
WIDER_SIDE = 18  # of its features at a quarter of the size, where the border reaches 8 pixels through the next layer


class GGCNNAround:
    """GG-CNN, whose two largest convolutions are evaluated as far as the objects reach, and whose last transposed
    convolution and heads where maps are wanted.
    """

    def __init__(self, network: GGCNN, precision: str) -> None:
        self._network, self._precision = network, precision
        self._heads = ShuffledHeads(network)

    def __call__(self, image: np.ndarray, objects: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the maps, shape (4, h, w), and where they are the network's, shape (h, w), bool: at least where they
        are wanted, shape (h, w), bool. Elsewhere they are 0.

        `image`: network's input, shape (h, w), float32 [m], one constant beside the objects; `objects`: shape (h, w),
        bool.
        """
        pixels = blocks(wanted, 3)
        maps = np.zeros((4, *image.shape), np.float32)
        with torch.inference_mode(), convolutions_in(self._precision):
            features = self._network.upwards(tensor(self._encoded(image, objects)))
            self._heads.into(maps, array(features), strips(pixels, ROWS, ShuffledHeads.seam), ROWS)
        return _only(maps, enlarged(pixels, 3))

    def _encoded(self, image: np.ndarray, objects: np.ndarray) -> np.ndarray:
        """Returns the features behind the second layer, shape (h / 6, w / 6, 16)."""
        (h, w), net = image.shape, self._network
        small = np.full((SMALL_SIDE, SMALL_SIDE, 1), _beside(image, objects), np.float32)
        x, reached = image[..., None], objects
        for layer, border, step in ((net.conv1, net.borders.conv[0], 3), (net.conv2, net.borders.conv[1], 2)):
            h, w, reached = h // step, w // step, near(blocks(reached, step), 1)
            small = array(bordered(layer, tensor(small), border))
            result = _spread(small, h, w)
            _into(result, x, layer, reached, before=border[0])
            x = result
        return x


class GGCNN2Around:
    """GG-CNN2, whose layers are evaluated near the objects only: as far as these reach, or as maps are wanted."""

    def __init__(self, network: GGCNN2, precision: str) -> None:
        self._precision, layers = precision, list(network.features)
        self._full1, self._full2, self._half1, self._half2, *later = _convolutions(layers)
        self._quarter1, self._quarter2, self._half3, self._full3 = later
        self._twice = layers[14]
        weight, bias = stacked_heads(network)
        self._heads = weight.detach()[:, :, 0, 0].t().contiguous(), bias.detach()

    def __call__(self, image: np.ndarray, objects: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the maps, shape (4, h, w), and where they are the network's, shape (h, w), bool: at least where they
        are wanted, shape (h, w), bool. Elsewhere they are 0.

        `image`: network's input, shape (h, w), float32 [m], at least 4 `WIDER_SIDE` rows and columns, one constant
        beside the objects; `objects`: shape (h, w), bool.
        """
        with torch.inference_mode(), convolutions_in(self._precision):
            half = blocks(wanted, 2)
            maps = self._decoded(self._encoded(image, objects), half)
            return _only(maps, enlarged(half, 2))

    def _encoded(self, image: np.ndarray, objects: np.ndarray) -> np.ndarray:
        """Returns the features behind the first dilated layer, shape (h / 4, w / 4, 32)."""
        h, w = (size // 2 for size in image.shape)
        full = _everywhere(self._full1, torch.full((1, 1, CONSTANT_SIDE, CONSTANT_SIDE), _beside(image, objects)))
        small1 = F.max_pool2d(_everywhere(self._full2, full), 2)
        small2 = _everywhere(self._half1, small1)
        small3 = array(F.max_pool2d(_everywhere(self._half2, small2), 2))
        small4 = _everywhere(self._quarter1, tensor(_spread(small3, WIDER_SIDE, WIDER_SIDE)))
        half1, half2 = (_spread(array(small), h, w) for small in (small1, small2))
        quarter1, quarter2 = (_spread(small, h // 2, w // 2) for small in (small3, array(small4)))
        reached = near(blocks(objects, 2), 4)  # at half size, through 11 x 11 and 5 x 5
        self._pooled(half1, image[..., None], reached)
        reached = near(reached, 2)
        _into(half2, half1, self._half1, reached)
        reached = blocks(near(reached, 2), 2)
        _into(quarter1, half2, self._half2, reached, pooling=2)
        _into(quarter2, quarter1, self._quarter1, near(reached, 4))
        return quarter2

    def _pooled(self, result: np.ndarray, image: np.ndarray, wanted: np.ndarray) -> None:
        """Writes what the layers of full size make of the image, shape (2 h, 2 w, 1), behind their pooling into the
        result, shape (h, w, 16), where it is wanted, shape (h, w).
        """
        found, rows, reach = strips(wanted, ROWS // 2), ROWS, int(self._full2.padding[0])
        pad = int(self._full1.padding[0]) + reach
        between = _convolved(
            self._full1, side_by_side([with_margin(image, s.scaled(2), rows, pad, pad) for s in found])
        )
        parts, column = [], 0
        for strip in found:
            width = 2 * (strip.stop - strip.start)
            part = between[:, column : column + width + 2 * reach]
            column += width + 2 * pad
            # The second layer has zeros outside of the image.
            part[: max(0, reach - 2 * strip.row)] = 0.0
            part[len(image) + reach - 2 * strip.row :] = 0.0
            part[:, : max(0, reach - 2 * strip.start)] = 0.0
            part[:, image.shape[1] + reach - 2 * strip.start :] = 0.0
            parts.append(part)
        values = F.max_pool2d(tensor(_convolved(self._full2, side_by_side(parts))), 2)
        put(result, found, array(values), reach)

    def _decoded(self, encoded: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Returns the maps, shape (4, 2 h, 2 w), where `wanted`, shape (h, w), at half size; elsewhere 0."""
        h, w = wanted.shape
        quarter, half = np.zeros((h // 2, w // 2, 32), np.float32), np.zeros((h, w, 16), np.float32)
        maps = np.zeros((4, 2 * h, 2 * w), np.float32)
        # A pixel of twice the size is interpolated from pixels within 1, and a convolution of 3 x 3 reaches 1 more.
        _into(quarter, encoded, self._quarter2, near(blocks(near(wanted, 3), 2), 1))
        _into(half, self._doubled(quarter), self._half3, near(wanted, 2))
        found = strips(wanted, ROWS // 2)
        features = self._doubled(half)
        parts = [with_margin(features, s.scaled(2), ROWS, 1, 1) for s in found]
        x = _convolved(self._full3, side_by_side(parts))
        values = torch.addmm(self._heads[1], torch.from_numpy(x).view(-1, x.shape[2]), self._heads[0])
        put(maps.transpose(1, 2, 0), [s.scaled(2) for s in found], values.view(*x.shape[:2], 4).float().numpy(), 2)
        return maps

    def _doubled(self, features: np.ndarray) -> np.ndarray:
        """Returns features of twice the size, shape (2 h, 2 w, c)."""
        return array(self._twice(tensor(features)))


def around(network: nn.Module, precision: str = FLOAT32) -> GGCNNAround | GGCNN2Around | None:
    """Returns what evaluates a network near objects only, in one of the `PRECISIONS`; None for another network than
    GG-CNN and GG-CNN2.
    """
    if isinstance(network, GGCNN):
        return GGCNNAround(channels_last(network.eval()), precision)
    return GGCNN2Around(channels_last(network.eval()), precision) if isinstance(network, GGCNN2) else None


def _convolutions(layers: Iterable[nn.Module]) -> list[nn.Conv2d]:
    return [layer for layer in layers if isinstance(layer, nn.Conv2d)]


def _everywhere(layer: nn.Conv2d, x: torch.Tensor) -> torch.Tensor:
    return F.conv2d(x, layer.weight, layer.bias, 1, layer.padding, layer.dilation).relu_()


def _convolved(layer: nn.Conv2d, laid: np.ndarray) -> np.ndarray:
    x = F.conv2d(tensor(laid), layer.weight, layer.bias, layer.stride, dilation=layer.dilation)
    return array(x.relu_())


def _into(
    result: np.ndarray, x: np.ndarray, layer: nn.Conv2d, wanted: np.ndarray, pooling: int = 1, before: int | None = None
) -> None:
    """Writes what a convolution makes of the features `x`, after a pooling of so many rows and columns, into the
    result, shape (h, w, d), where it is wanted, shape (h, w). `before`: zeros before the image, None: as in the layer.
    """
    stride, rows = int(layer.stride[0]), ROWS // pooling
    step, span = stride * pooling, int(layer.dilation[0]) * (int(layer.kernel_size[0]) - 1) + 1
    before = int(layer.padding[0]) if before is None else before
    seam = -(-(span - stride) // step)
    found = strips(wanted, rows, seam)
    parts = [with_margin(x, strip.scaled(step), step * rows, before, step * seam - before) for strip in found]
    values = _convolved(layer, side_by_side(parts))
    if pooling > 1:
        values = array(F.max_pool2d(tensor(values), pooling))
    put(result, found, values, seam)


def _beside(image: np.ndarray, objects: np.ndarray) -> float:
    """Returns the constant that the image is beside the objects; 0 if there is nothing beside them."""
    return 0.0 if objects.all() else float(image.flat[np.argmin(objects)])


def _spread(features: np.ndarray, h: int, w: int) -> np.ndarray:
    """Returns a constant image's features, shape (n, n, c), as those of a larger one, shape (h, w, c)."""
    middle, behind = len(features) // 2, (len(features) - 1) // 2
    spread = np.empty((h, w, features.shape[2]), np.float32)
    # The middle pixel is repeated; before it are those near the first border, behind it those near the last.
    for rows, of_rows in zip(*_thirds(h, middle, behind)):
        for columns, of_columns in zip(*_thirds(w, middle, behind)):
            spread[rows, columns] = features[of_rows, of_columns]
    return spread


def _thirds(size: int, middle: int, behind: int) -> tuple[list[slice], list[slice]]:
    """Returns the parts of a side before, in and behind its middle, and those of the small side that they repeat."""
    parts = slice(0, middle), slice(middle, size - behind), slice(size - behind, size)
    return list(parts), [slice(0, middle), slice(middle, middle + 1), slice(middle + 1, middle + 1 + behind)]


def _only(maps: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the maps with zeros where they are not known, and where they are."""
    np.copyto(maps, 0.0, where=~known)
    return maps, known
