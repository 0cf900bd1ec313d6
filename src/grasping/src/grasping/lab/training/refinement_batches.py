"""Batches for the refinement network, and what it should say of them.

Examples are taken as they are: what the network looks at does not change when the image is turned or shifted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from grasping.lab.training.refinement_examples import Example, OperatorOffset
from grasping.network.refinement import SHRINK, SIDE

SIGMA_PX = 1.25
"""Of the target about the operator's pixel, 5 px of the network's image."""


class RefinementTargets(NamedTuple):
    """What the refinement network should say of n images; the constant offset is taken off all."""

    place: torch.Tensor  # about the operator's pixel, sum 1, shape (n, SIDE, SIDE)
    held: torch.Tensor  # 1 where the operator's grasp held, 0 where it failed, shape (n,)
    height: torch.Tensor  # of the grasp above the table, along the optical axis, shape (n,) [m]
    cos: torch.Tensor  # of twice the angle of the line through the fingers, shape (n,)
    sin: torch.Tensor  # likewise
    tilt_x: torch.Tensor  # of the approach, shape (n,) [rad]
    tilt_y: torch.Tensor  # likewise
    opening: torch.Tensor  # of the hand, shape (n,) [GGCNN's unit x m]; NaN where it is not known

    def to(self, device: torch.device) -> RefinementTargets:
        """Returns the targets on a device."""
        return RefinementTargets(*(value.to(device) for value in self))


def batch(examples: list[Example], offset: OperatorOffset) -> tuple[torch.Tensor, RefinementTargets]:
    """Returns examples as the network's input, shape (n, features, SIDE, SIDE), and what it should say."""
    seen = torch.from_numpy(np.stack([np.float32(e.features) for e in examples]))
    places = torch.from_numpy(np.stack([place_target(*place(e, offset)) for e in examples]))
    rest = [
        (
            e.held,
            e.height + offset.depth,
            np.cos(2.0 * (e.angle - offset.angle)),
            np.sin(2.0 * (e.angle - offset.angle)),
            e.tilt_x - offset.tilt_x,
            e.tilt_y - offset.tilt_y,
            e.opening - offset.opening,
        )
        for e in examples
    ]
    return seen, RefinementTargets(places, *torch.tensor(rest, dtype=torch.float32).unbind(1))


def place(example: Example, offset: OperatorOffset) -> tuple[float, float]:
    """Returns row and column of the operator's grasp without the constant offset."""
    scale = SHRINK * example.mean
    return example.row - offset.y / scale, example.column - offset.x / scale


def place_target(row: float, column: float) -> np.ndarray:
    """Returns a bell of sum 1 about a pixel, shape (SIDE, SIDE), zeros where it lies outside."""
    at = np.arange(SIDE)
    bell = np.outer(*(np.exp(-0.5 * ((at - c) / SIGMA_PX) ** 2) for c in (row, column)))
    return (bell / max(float(bell.sum()), 1.0)).astype(np.float32)
