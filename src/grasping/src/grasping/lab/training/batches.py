"""Training batches: windows of labelled images, mirrored at random.

Mirroring is all that may be done to the labels: between directions equally good they prefer the horizontal one
(synthetic.labels), which a mirror keeps and a turn would not.
"""

from __future__ import annotations

from typing import Mapping, NamedTuple

import numpy as np
import torch

GRASPABLE = 0.3
"""From this quality on a pixel teaches angle and width."""
CENTRED_SHARE = 0.8
"""Share of the windows that are centred near a pixel that can be grasped."""
MEAN_JITTER_M = 0.02

Samples = Mapping[str, np.ndarray]


class MapTargets(NamedTuple):
    """What the network should say; each shape (n, h, w)."""

    quality: torch.Tensor  # 0 to 1
    cos: torch.Tensor  # of twice the angle
    sin: torch.Tensor  # of twice the angle
    width: torch.Tensor  # in units of `WIDTH_SCALE_PX`
    known: torch.Tensor  # where the quality counts, bool
    graspable: torch.Tensor  # where cos, sin and width count, bool


def random_batch(samples: Samples, rng: np.random.Generator, count: int, side: int) -> tuple[torch.Tensor, MapTargets]:
    """Returns `count` random windows of `side` pixels as input, shape (n, 1, side, side), and targets.

    Args:
        samples: arrays `depth`, `quality`, `angle`, `width`, `known`, each shape (m, 300, 300), as
            `synthetic.samples.Sample` has them.
    """
    windows = [_window(samples, rng, side) for _ in range(count)]
    depth, target = batch({name: np.stack([w[name] for w in windows]) for name in windows[0]})
    jitter = torch.from_numpy(rng.normal(0.0, MEAN_JITTER_M, (count, 1, 1, 1)).astype(np.float32))
    return depth + jitter, target


def batch(samples: Samples) -> tuple[torch.Tensor, MapTargets]:
    """Returns whole samples as input and targets."""
    depth = torch.from_numpy(samples["depth"].astype(np.float32)).clamp(-1.0, 1.0)[:, None]
    angle = samples["angle"].astype(np.float32) * (2.0 * np.pi / 256.0)
    quality = torch.from_numpy(samples["quality"].astype(np.float32) / 255.0)
    cos, sin = torch.from_numpy(np.cos(angle)), torch.from_numpy(np.sin(angle))
    width = torch.from_numpy(samples["width"].astype(np.float32) / 255.0)
    known = torch.from_numpy(samples["known"])
    return depth, MapTargets(quality, cos, sin, width, known, known & (quality > GRASPABLE))


def _window(samples: Samples, rng: np.random.Generator, side: int) -> dict[str, np.ndarray]:
    """Returns one window of one sample, perhaps mirrored."""
    i = rng.integers(len(samples["depth"]))
    h, w = samples["depth"].shape[1:]
    row, column = rng.integers(0, h - side + 1), rng.integers(0, w - side + 1)
    graspable = np.flatnonzero(samples["quality"][i] > GRASPABLE * 255.0)
    if len(graspable) and rng.random() < CENTRED_SHARE:
        y, x = divmod(int(rng.choice(graspable)), w)
        row, column = (
            int(np.clip(c - side // 2 + rng.integers(-side // 3, side // 3 + 1), 0, n - side))
            for c, n in ((y, h), (x, w))
        )
    flips = rng.random(2) < 0.5
    window = {}
    for name in ("depth", "quality", "angle", "width", "known"):
        part = samples[name][i, row : row + side, column : column + side]
        part = part[::-1] if flips[0] else part
        window[name] = part[:, ::-1] if flips[1] else part
    if flips[0] != flips[1]:
        window["angle"] = (256 - window["angle"].astype(np.int16)).astype(np.uint8)
    return window
