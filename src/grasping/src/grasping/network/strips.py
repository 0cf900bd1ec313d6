"""Parts of an image's bands of rows, laid side by side: one call evaluates a layer in all of them.

What a layer makes across the seams is left out. Arrays of features have the channels last, shape (h, w, c).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import torch

COLUMNS = 32  # strips are filled up to a multiple: oneDNN compiles a convolution for each size


class Strip(NamedTuple):
    """A part of a band of rows; all strips of a layer have as many rows."""

    row: int  # the first
    start: int  # first column
    stop: int  # column behind the last

    def scaled(self, factor: int) -> Strip:
        """Returns the same part of an image that is larger by a factor."""
        return Strip(factor * self.row, factor * self.start, factor * self.stop)


def strips(wanted: np.ndarray, rows: int, gap: int = 0) -> list[Strip]:
    """Returns strips of so many rows inside of the image that hold all that is wanted, shape (h, w), bool; strips of a
    band that are no more than `gap` columns apart are one.
    """
    h, w = wanted.shape
    bands = np.zeros((-(-h // rows), w + 2), bool)
    np.logical_or.reduceat(wanted, np.arange(0, h, rows), axis=0, out=bands[:, 1:-1])
    band, edges = (found.tolist() for found in np.nonzero(bands[:, 1:] != bands[:, :-1]))
    found: list[Strip] = []
    for row, start, stop in zip(band[::2], edges[::2], edges[1::2]):
        row = min(rows * row, h - rows)
        if found and found[-1].row == row and start - found[-1].stop <= gap:
            start = found.pop().start
        found.append(Strip(row, start, stop))
    return found


def with_margin(x: np.ndarray, strip: Strip, rows: int, before: int, after: int) -> np.ndarray:
    """Returns a strip of the features with more rows and columns before and after it, zeros outside of the image."""
    h, w, _ = x.shape
    top, bottom, left, right = strip.row - before, strip.row + rows + after, strip.start - before, strip.stop + after
    inside = x[max(0, top) : bottom, max(0, left) : right]
    if inside.shape[:2] == (bottom - top, right - left):
        return inside
    missing = (max(0, -top), max(0, bottom - h)), (max(0, -left), max(0, right - w)), (0, 0)
    return np.pad(inside, missing)


def side_by_side(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Returns parts of features, each of shape (h, w, c), beside each other, filled up with zeros."""
    h, _, c = parts[0].shape
    rest = -sum(part.shape[1] for part in parts) % COLUMNS
    return np.concatenate([*parts, np.zeros((h, rest, c), np.float32)], axis=1)


def put(result: np.ndarray, strips: Iterable[Strip], values: np.ndarray, seam: int) -> None:
    """Writes strips that lie side by side, `seam` columns apart, into features."""
    column = 0
    for row, start, stop in strips:
        result[row : row + len(values), start:stop] = values[:, column : column + stop - start]
        column += stop - start + seam


def tensor(features: np.ndarray) -> torch.Tensor:
    """Returns features, shape (h, w, c), as a tensor of shape (1, c, h, w)."""
    return torch.from_numpy(features)[None].permute(0, 3, 1, 2)


def array(features: torch.Tensor) -> np.ndarray:
    """Returns a tensor of shape (1, c, h, w) as features, shape (h, w, c), float32, whatever its precision."""
    return np.ascontiguousarray(features[0].permute(1, 2, 0).float().numpy())
