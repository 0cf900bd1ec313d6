"""The maps of GG-CNN and GG-CNN2 near the objects of a view from above the table, where the other pixels are not read.

The input of such a view is one constant beside its objects. What a layer makes of a constant depends only on the
distance from the image's border, so GG-CNN2's first layers take it from a small constant image and evaluate only what
the objects reach. The last layers of both networks are evaluated only where their maps are wanted. The wanted maps
are the plain network's to rounding.
Layers are evaluated in tiles of one size, a few at a time: they stay in the processor's cache, and oneDNN compiles a
convolution anew for each size. Arrays of features have the channels last, shape (h, w, c).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from grasping.network.networks import GGCNN, GGCNN2, ShuffledHeads, stacked_heads

Tile = tuple[int, int]  # first row and column
Convolution = tuple[torch.Tensor, torch.Tensor, int]  # weight, bias, dilation

ROWS = 10  # of GG-CNN's features, a third of the maps' size, in a band
BATCH = 8  # tiles of GG-CNN2
TILE = 14  # rows and columns of a tile of GG-CNN2's features, at half and quarter size
CONSTANT_SIDE = 40  # of the constant image; the border reaches 4 of its 10 quarter-size pixels from each side
FIRST, SECOND = ((0, 2), (5, 7))  # GG-CNN2's convolutions before and behind its first pooling


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
            self._heads.into(torch.from_numpy(maps), features, bands(wanted, ROWS))
        return _only(maps, _enlarged(wanted, 3))


class GGCNN2Around:
    """GG-CNN2, whose layers are evaluated near the objects only; the fifth convolution is evaluated everywhere."""

    def __init__(self, network: GGCNN2) -> None:
        layers = network.features
        self._convolutions = {
            i: (m.weight.detach().contiguous(memory_format=torch.channels_last), m.bias.detach(), m.dilation[0])
            for i, m in enumerate(layers)
            if isinstance(m, nn.Conv2d)
        }
        self._encoder = layers[:10]
        weight, bias = stacked_heads(network)
        self._heads = weight.detach()[:, :, 0, 0].t().contiguous(), bias.detach()

    def __call__(self, image: np.ndarray, objects: np.ndarray, margin: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the maps, shape (4, h, w), and where they are the network's, shape (h, w), bool: at least within
        `margin` rows and columns of the objects. Elsewhere they are 0.

        `image`: network's input, shape (h, w), float32 [m], one constant beside the objects; `objects`: shape (h, w),
        bool.
        """
        with torch.inference_mode():
            blocks = _blocks(objects, 2)
            encoded = self._encoded(image, blocks, float(image[~objects][0]) if not objects.all() else 0.0)
            wanted = _near(blocks, -(-margin // 2))
            return _only(self._decoded(encoded, wanted), _enlarged(wanted, 2))

    def _encoded(self, image: np.ndarray, blocks: np.ndarray, constant: float) -> np.ndarray:
        """Returns the features behind the second pooling, shape (h / 4, w / 4, 16). `blocks`: where objects are."""
        h, w = blocks.shape
        of_constant = torch.full((1, 1, CONSTANT_SIDE, CONSTANT_SIDE), constant)
        halves = _channels_last(self._encoder[:5](of_constant))
        quarters = _channels_last(self._encoder[5:](torch.from_numpy(halves)[None].permute(0, 3, 1, 2)))
        half = np.zeros((h + 8, w + 8, halves.shape[2]), np.float32)
        half[4:-4, 4:-4] = _spread(halves, h, w)
        quarter = _spread(quarters, h // 2, w // 2)
        padded = np.zeros((2 * h + 14, 2 * w + 14, 1), np.float32)
        padded[7:-7, 7:-7, 0] = image
        reached = _near(blocks, 4)  # half-size pixels that an object reaches through 11 x 11 and 5 x 5
        self._two_and_pool(padded, half[4:-4, 4:-4], FIRST, _tiles(reached, TILE))
        reached = _near(_blocks(reached, 2), 2)  # quarter-size pixels, through 5 x 5 twice
        self._two_and_pool(half, quarter, SECOND, _tiles(reached, TILE // 2))
        return quarter

    def _two_and_pool(
        self, padded: np.ndarray, into: np.ndarray, numbers: tuple[int, int], tiles: Sequence[Tile]
    ) -> None:
        """Writes tiles of what two convolutions and a pooling make of an array that is padded for both."""
        (first, second), (h, w) = (self._convolutions[i] for i in numbers), into.shape[:2]
        reach = second[0].shape[2] // 2
        pad = first[0].shape[2] // 2 + reach
        side = min(TILE if numbers == FIRST else TILE // 2, h, w)
        for batch in _batches(tiles):
            x = _convolved(_cut(padded, [(2 * r, 2 * c) for r, c in batch], 2 * side + 2 * pad), first)
            for i, (row, column) in enumerate(batch):  # the second convolution has zeros outside of the image
                for axis, start, size in ((1, 2 * row, 2 * h), (2, 2 * column, 2 * w)):
                    if start < reach:
                        x[i].narrow(axis, 0, reach - start).zero_()
                    after = start + 2 * side + reach - size
                    if after > 0:
                        x[i].narrow(axis, x.shape[axis + 1] - after, after).zero_()
            _put(into, batch, F.max_pool2d(_convolved(x, second), 2))

    def _decoded(self, encoded: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Returns the maps, shape (4, 2 h, 2 w), right where `wanted`, shape (h, w), at half size."""
        h, w = wanted.shape
        x = torch.from_numpy(encoded)[None].permute(0, 3, 1, 2)
        fifth = _convolved(x, self._convolutions[10], padding=4)
        padded = np.zeros((h // 2 + 16, w // 2 + 16, fifth.shape[1]), np.float32)
        padded[8:-8, 8:-8] = _channels_last(fifth)
        half = _near(wanted, 1)
        sixth = np.zeros((h // 2, w // 2, 32), np.float32)
        for batch in _batches(_tiles(_near(_blocks(half, 2), 1), TILE)):
            _put(sixth, batch, _convolved(_cut(padded, batch, min(TILE, h // 2, w // 2) + 16), self._convolutions[12]))
        seventh = np.zeros((h, w, 16), np.float32)
        for batch in _batches(_tiles(half, TILE)):
            _put(seventh, batch, _convolved(_twice(sixth, batch, min(TILE, h, w)), self._convolutions[15]))
        maps = np.zeros((2 * h, 2 * w, 4), np.float32)
        for batch in _batches(_tiles(wanted, TILE)):
            batch = [(2 * row, 2 * column) for row, column in batch]
            x = _convolved(_twice(seventh, batch, 2 * min(TILE, h, w)), self._convolutions[18])
            heads = torch.addmm(self._heads[1], x.permute(0, 2, 3, 1).reshape(-1, 16), self._heads[0])
            _put(maps, batch, heads.view(len(x), *x.shape[2:], 4).permute(0, 3, 1, 2))
        return np.ascontiguousarray(maps.transpose(2, 0, 1))


Around = Callable[[np.ndarray, np.ndarray, int], "tuple[np.ndarray, np.ndarray]"]


def around(network: nn.Module) -> Around | None:
    """Returns what evaluates a network near objects only; None for another network than GG-CNN and GG-CNN2."""
    if isinstance(network, GGCNN):
        return GGCNNAround(network)
    return GGCNN2Around(network) if isinstance(network, GGCNN2) else None


def bands(wanted: np.ndarray, rows: int) -> list[tuple[int, int, int, int]]:
    """Returns rectangles (first row, first column, rows, columns) that hold all that is wanted, shape (h, w), bool."""
    found, row = [], 0
    occupied = wanted.any(axis=1)
    while row < len(wanted):
        if not occupied[row]:
            row += 1
            continue
        count = min(rows, len(wanted) - row)
        edges = np.flatnonzero(np.diff(wanted[row : row + count].any(axis=0).astype(np.int8), prepend=0, append=0))
        found += [(row, int(a), count, int(b - a)) for a, b in edges.reshape(-1, 2)]
        row += count
    return found


def _tiles(wanted: np.ndarray, side: int) -> list[Tile]:
    """Returns squares inside of the image that hold all that is wanted."""
    h, w = wanted.shape
    side = min(side, h, w)
    return [
        (min(row, h - side), min(column + i, w - side))
        for row, column, _, width in bands(wanted, side)
        for i in range(0, width, side)
    ]


def _batches(tiles: Sequence[Tile]) -> Iterator[list[Tile]]:
    """Yields the tiles in batches of `BATCH` or half of it; the last tile fills the last batch."""
    for i in range(0, len(tiles), BATCH):
        batch = list(tiles[i : i + BATCH])
        size = BATCH // 2 if len(batch) <= BATCH // 2 else BATCH
        yield batch + [batch[-1]] * (size - len(batch))


def _convolved(x: torch.Tensor, convolution: Convolution, padding: int = 0) -> torch.Tensor:
    weight, bias, dilation = convolution
    return F.conv2d(x, weight, bias, padding=padding, dilation=dilation).relu_()


def _cut(features: np.ndarray, tiles: Sequence[Tile], side: int) -> torch.Tensor:
    """Returns the tiles, shape (n, c, side, side)."""
    cut = np.stack([features[row : row + side, column : column + side] for row, column in tiles])
    return torch.from_numpy(cut).permute(0, 3, 1, 2)


def _put(features: np.ndarray, tiles: Sequence[Tile], values: torch.Tensor) -> None:
    """Writes the tiles, shape (n, c, side, side), into the features."""
    side = values.shape[2]
    for (row, column), tile in zip(tiles, values.permute(0, 2, 3, 1).numpy()):
        features[row : row + side, column : column + side] = tile


def _twice(features: np.ndarray, tiles: Sequence[Tile], side: int) -> torch.Tensor:
    """Returns tiles of the features at twice the size, interpolated as nn.UpsamplingBilinear2d does, with one row and
    column more on each side, zero outside of the image; shape (n, c, side + 2, side + 2).
    """
    h, w, c = features.shape
    size = min(side // 2 + 3, h, w)
    rows, columns = ([_interpolation(tile[axis] - 1, side + 2, n, size) for tile in tiles] for axis, n in enumerate((h, w)))
    cut = np.stack([features[r : r + size, q : q + size] for (r, _), (q, _) in zip(rows, columns)])
    down, across = (torch.from_numpy(np.stack([matrix for _, matrix in part])) for part in (rows, columns))
    tall = torch.bmm(down, torch.from_numpy(cut.reshape(len(tiles), size, size * c)))
    wide = torch.matmul(across[:, None], tall.view(len(tiles), side + 2, size, c))
    return wide.permute(0, 3, 1, 2)


def _interpolation(first: int, count: int, n: int, size: int) -> tuple[int, np.ndarray]:
    """Returns the first of the `size` of `n` pixels that `count` pixels of the doubled row are made of, from its pixel
    `first` on, and their weights, shape (count, size); zeros for what is outside of the row.
    """
    pixels = np.arange(first, first + count)
    at = np.clip(pixels, 0, 2 * n - 1) * ((n - 1) / (2 * n - 1))
    begin = min(int(at[0]), n - size)
    weights = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(begin, begin + size)))
    weights[(pixels < 0) | (pixels >= 2 * n)] = 0.0
    return begin, weights.astype(np.float32)


def _spread(features: np.ndarray, h: int, w: int) -> np.ndarray:
    """Returns a constant image's features, shape (n, n, c), as those of a larger one, shape (h, w, c)."""
    n = len(features)
    rows, columns = (np.clip(np.arange(size), 0, n // 2) + np.maximum(0, np.arange(size) - (size - n + n // 2)) for size in (h, w))
    return features[rows][:, columns]


def _channels_last(x: torch.Tensor) -> np.ndarray:
    """Returns the features of one image, shape (1, c, h, w), as (h, w, c)."""
    return np.ascontiguousarray(x[0].permute(1, 2, 0).numpy())


def _blocks(mask: np.ndarray, side: int) -> np.ndarray:
    """Returns which blocks of `side` rows and columns hold anything, shape (h / side, w / side), bool."""
    h, w = mask.shape
    return mask.reshape(h // side, side, w // side, side).any(axis=(1, 3))


def _near(mask: np.ndarray, distance: int) -> np.ndarray:
    """Returns what is within `distance` rows and columns of the mask, bool."""
    return cv2.dilate(mask.view(np.uint8), np.ones((2 * distance + 1, 2 * distance + 1), np.uint8)).view(bool)


def _enlarged(mask: np.ndarray, factor: int) -> np.ndarray:
    return mask.repeat(factor, axis=0).repeat(factor, axis=1)


def _only(maps: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the maps with zeros where they are not known, and where they are."""
    np.copyto(maps, 0.0, where=~known)
    return maps, known
