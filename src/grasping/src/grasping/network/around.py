"""The maps of GG-CNN and GG-CNN2 near the objects of a view from above the table, where the other pixels are not read.

The input of such a view is one constant beside its objects. What a layer makes of a constant depends only on the
distance from the image's border, so GG-CNN2's first layers take it from a small constant image and evaluate only what
the objects reach. The last layers of both networks are evaluated only where their maps are wanted. The wanted maps
are the plain network's to rounding.
Layers are evaluated in tiles of one size, a few at a time: they stay in the processor's cache, and oneDNN compiles a
convolution anew for each size. Arrays of features have the channels last, shape (h, w, c).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from grasping.network.networks import BAND, GGCNN, GGCNN2, ShuffledHeads, channels_last, stacked_heads

BATCH = 16  # tiles of GG-CNN2 at most, and a multiple of
STEP = 4
FULL_TILE = 20  # rows and columns of a tile of GG-CNN2's features at full size
HALF_TILE = 14  # and at half size
CONSTANT_SIDE = 40  # of the constant image; the border reaches 4 of its 10 quarter-size pixels from each side


class GGCNNAround:
    """GG-CNN, whose last transposed convolution and heads are evaluated near the objects only."""

    def __init__(self, network: GGCNN) -> None:
        self._network = network
        self._heads = ShuffledHeads(network)

    def __call__(self, image: np.ndarray, objects: np.ndarray, margin: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the maps, shape (4, h, w), and where they are the network's, shape (h, w), bool: at least within
        `margin` rows and columns of the objects. Elsewhere they are 0.

        `image`: network's input, shape (h, w), float32 [m]; `objects`: shape (h, w), bool.
        """
        wanted = _near(_blocks(objects, 3), -(-margin // 3))
        maps = np.zeros((4, *image.shape), np.float32)
        with torch.inference_mode():
            features = self._network.features(torch.from_numpy(image)[None, None])
            self._heads.into(torch.from_numpy(maps), features, windows(wanted, BAND))
        return _only(maps, _enlarged(wanted, 3))


class GGCNN2Around:
    """GG-CNN2, whose layers of full and half size before the middle ones, and of full size behind them, are evaluated
    near the objects only.
    """

    def __init__(self, network: GGCNN2) -> None:
        layers = list(network.features)
        self._first, self._second = (_TwoAndPool(*_convolutions(part)) for part in (layers[:5], layers[5:10]))
        self._middle, self._twice, (self._last,) = nn.Sequential(*layers[10:17]), layers[17], _convolutions(layers[18:])
        weight, bias = stacked_heads(network)
        self._heads = weight.detach()[:, :, 0, 0].t().contiguous(), bias.detach()

    def __call__(self, image: np.ndarray, objects: np.ndarray, margin: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the maps, shape (4, h, w), and where they are the network's, shape (h, w), bool: at least within
        `margin` rows and columns of the objects. Elsewhere they are 0.

        `image`: network's input, shape (h, w), float32 [m], at least `CONSTANT_SIDE` rows and columns, one constant
        beside the objects; `objects`: shape (h, w), bool.
        """
        with torch.inference_mode():
            blocks = _blocks(objects, 2)
            wanted = _near(blocks, -(-margin // 2))
            maps = self._decoded(self._encoded(image, objects, blocks), wanted)
            return _only(maps, _enlarged(wanted, 2))

    def _encoded(self, image: np.ndarray, objects: np.ndarray, blocks: np.ndarray) -> np.ndarray:
        """Returns the features behind the second pooling, shape (h / 4, w / 4, 16). `blocks`: where objects are."""
        h, w = blocks.shape
        constant = 0.0 if objects.all() else float(image.flat[np.argmin(objects)])
        halves = self._first.everywhere(torch.full((1, 1, CONSTANT_SIDE, CONSTANT_SIDE), constant))
        half = _spread(_channels_last(halves), h, w)
        quarter = _spread(_channels_last(self._second.everywhere(halves)), h // 2, w // 2)
        reached = _near(blocks, 4)  # half-size pixels that an object reaches through 11 x 11 and 5 x 5
        self._first.into(half, image[..., None], reached, FULL_TILE // 2)
        reached = _near(_blocks(reached, 2), 2)  # quarter-size pixels, through 5 x 5 twice
        self._second.into(quarter, half, reached, HALF_TILE // 2)
        return quarter

    def _decoded(self, encoded: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Returns the maps, shape (4, 2 h, 2 w), right where `wanted`, shape (h, w), at half size."""
        x = self._middle(torch.from_numpy(encoded)[None].permute(0, 3, 1, 2))
        features = self._twice(x)[0].permute(1, 2, 0).numpy()
        h, w = wanted.shape
        maps = np.zeros((2 * h, 2 * w, 4), np.float32)
        side = min(FULL_TILE, 2 * h, 2 * w)
        for batch in _batches(tiles(wanted, side // 2)):
            corners = [(2 * row, 2 * column) for row, column in batch]
            x = _convolved(self._last, _cut(features, [(row - 1, column - 1) for row, column in corners], side + 2))
            heads = torch.addmm(self._heads[1], x.permute(0, 2, 3, 1).reshape(-1, x.shape[1]), self._heads[0])
            _put(maps, corners, heads.view(-1, side, side, 4).permute(0, 3, 1, 2))
        return np.ascontiguousarray(maps.transpose(2, 0, 1))


class _TwoAndPool:
    """Two convolutions and a pooling."""

    def __init__(self, first: nn.Conv2d, second: nn.Conv2d) -> None:
        self._first, self._second = first, second
        self._reach = int(second.padding[0])
        self._pad = int(first.padding[0]) + self._reach

    def everywhere(self, x: torch.Tensor) -> torch.Tensor:
        """Returns what they make of images, shape (n, c, h, w)."""
        return F.max_pool2d(F.relu_(self._second(F.relu_(self._first(x)))), 2)

    def into(self, result: np.ndarray, x: np.ndarray, wanted: np.ndarray, side: int) -> None:
        """Writes what they make of the features `x`, shape (2 h, 2 w, c), into the result, shape (h, w, d), where it is
        wanted, shape (h, w), in tiles of `side` rows and columns.
        """
        (h, w), reach, pad = wanted.shape, self._reach, self._pad
        side = min(side, h, w)
        for batch in _batches(tiles(wanted, side)):
            corners = [(2 * row - pad, 2 * column - pad) for row, column in batch]
            between = _convolved(self._first, _cut(x, corners, 2 * (side + pad)))
            for tile, (row, column) in zip(between, batch):  # the second convolution has zeros outside of the image
                for axis, start, size in ((1, 2 * row, 2 * h), (2, 2 * column, 2 * w)):
                    before, after = reach - start, start + 2 * side + reach - size
                    if before > 0:
                        tile.narrow(axis, 0, before).zero_()
                    if after > 0:
                        tile.narrow(axis, tile.shape[axis] - after, after).zero_()
            _put(result, batch, F.max_pool2d(_convolved(self._second, between), 2))


def around(network: nn.Module) -> GGCNNAround | GGCNN2Around | None:
    """Returns what evaluates a network near objects only; None for another network than GG-CNN and GG-CNN2."""
    if isinstance(network, GGCNN):
        return GGCNNAround(channels_last(network.eval()))
    return GGCNN2Around(channels_last(network.eval())) if isinstance(network, GGCNN2) else None


def windows(wanted: np.ndarray, rows: int) -> list[tuple[slice, slice]]:
    """Returns windows of at most so many rows, slices of rows and columns, that hold what is wanted, shape (h, w)."""
    found, row = [], 0
    occupied = wanted.any(axis=1).tolist()
    edge = np.zeros(wanted.shape[1] + 2, bool)
    while row < len(wanted):
        if not occupied[row]:
            row += 1
            continue
        end = min(row + rows, len(wanted))
        np.any(wanted[row:end], axis=0, out=edge[1:-1])
        ends = np.flatnonzero(edge[1:] != edge[:-1]).tolist()
        found += [(slice(row, end), slice(first, last)) for first, last in zip(ends[::2], ends[1::2])]
        row = end
    return found


def tiles(wanted: np.ndarray, side: int) -> list[tuple[int, int]]:
    """Returns squares inside of the image that hold all that is wanted, shape (h, w), bool."""
    h, w = wanted.shape
    side = min(side, h, w)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(wanted.view(np.uint8))
    found = []
    for label, (left, top, width, height) in zip(range(1, count), boxes[1:, :4].tolist()):
        for rows, columns in windows(labels[top : top + height, left : left + width] == label, side):
            row = min(top + rows.start, h - side)
            ends = range(left + columns.start, left + columns.stop, side)
            found += [(row, min(column, w - side)) for column in ends]
    return found


def _batches(tiles: Sequence[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
    """Yields the tiles in batches of a multiple of `STEP` tiles; the last tile fills the last batch."""
    for i in range(0, len(tiles), BATCH):
        batch = list(tiles[i : i + BATCH])
        yield batch + [batch[-1]] * (-len(batch) % STEP)


def _convolutions(layers: Iterable[nn.Module]) -> list[nn.Conv2d]:
    return [layer for layer in layers if isinstance(layer, nn.Conv2d)]


def _convolved(layer: nn.Conv2d, padded: torch.Tensor) -> torch.Tensor:
    return F.conv2d(padded, layer.weight, layer.bias).relu_()


def _cut(features: np.ndarray, tiles: Sequence[tuple[int, int]], side: int) -> torch.Tensor:
    """Returns the tiles, shape (n, c, side, side), with zeros outside of the image."""
    h, w, c = features.shape
    cut = np.empty((len(tiles), side, side, c), np.float32)
    for into, (row, column) in zip(cut, tiles):
        if row < 0 or column < 0 or row + side > h or column + side > w:
            into[:] = 0.0
            part = features[max(0, row) : row + side, max(0, column) : column + side]
            row, column = max(0, -row), max(0, -column)
            into[row : row + part.shape[0], column : column + part.shape[1]] = part
        else:
            into[:] = features[row : row + side, column : column + side]
    return torch.from_numpy(cut).permute(0, 3, 1, 2)


def _put(features: np.ndarray, tiles: Sequence[tuple[int, int]], values: torch.Tensor) -> None:
    """Writes the tiles, shape (n, c, side, side), into the features."""
    side = values.shape[2]
    for (row, column), tile in zip(tiles, values.permute(0, 2, 3, 1).numpy()):
        features[row : row + side, column : column + side] = tile


def _spread(features: np.ndarray, h: int, w: int) -> np.ndarray:
    """Returns a constant image's features, shape (n, n, c), as those of a larger one, shape (h, w, c)."""
    n = len(features)
    pixels = (np.arange(size) for size in (h, w))
    # The middle pixel is repeated; before it are those near the first border, behind it those near the last.
    rows, columns = (np.minimum(p, n // 2) + np.maximum(0, p - len(p) + n - n // 2) for p in pixels)
    return features[rows][:, columns]


def _channels_last(x: torch.Tensor) -> np.ndarray:
    """Returns the features of one image, shape (1, c, h, w), as (h, w, c)."""
    return np.ascontiguousarray(x[0].permute(1, 2, 0).numpy())


def _blocks(mask: np.ndarray, side: int) -> np.ndarray:
    """Returns which blocks of `side` rows and columns hold anything, shape (h / side, w / side), bool."""
    rows = np.logical_or.reduce([mask[i::side] for i in range(side)])
    return np.logical_or.reduce([rows[:, i::side] for i in range(side)])


def _near(mask: np.ndarray, distance: int) -> np.ndarray:
    """Returns what is within `distance` rows and columns of the mask, bool."""
    return cv2.dilate(mask.view(np.uint8), np.ones((2 * distance + 1, 2 * distance + 1), np.uint8)).view(bool)


def _enlarged(mask: np.ndarray, factor: int) -> np.ndarray:
    return mask.repeat(factor, axis=0).repeat(factor, axis=1)


def _only(maps: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the maps with zeros where they are not known, and where they are."""
    np.copyto(maps, 0.0, where=~known)
    return maps, known
