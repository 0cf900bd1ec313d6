"""What training of the second network makes small.

Of a person's grasp that held: the cross-entropy between a softmax over all pixels and a bell about the person's pixel,
and under that bell the Huber loss of the depth. Of one that failed: the mass of the softmax there. Everywhere: a little
of the quality's change itself.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F

from grasping.refinement import HEIGHT
from grasping.training.refinement_batches import Targets

SHARPNESS = 20.0
"""Logits of the softmax by quality."""
DEPTH_WEIGHT, CHANGE_WEIGHT = 0.5, 0.02
DEPTH_SCALE_M = 0.01
LEAST = 1e-6


class Losses(NamedTuple):
    """Means over the pictures that teach them; `total` is the weighted sum."""

    total: torch.Tensor
    place: torch.Tensor
    depth: torch.Tensor


def losses(seen: torch.Tensor, change: torch.Tensor, target: Targets) -> Losses:
    """Returns the losses of what the network adds.

    Args:
        seen: the network's input, shape (n, features, h, w).
        change: its output, shape (n, 2, h, w).
        target: what it should be.
    """
    quality = seen[:, 0] + change[:, 0]
    logs = F.log_softmax(SHARPNESS * quality.flatten(1), dim=1).view_as(quality)
    held, bell = target.held, target.place
    depth = (seen[:, HEIGHT] - change[:, 1] - target.height[:, None, None]) / DEPTH_SCALE_M
    of_place = held * (bell * (torch.log(bell.clamp(min=LEAST)) - logs)).sum((1, 2))
    of_depth = held * (bell * F.huber_loss(depth, torch.zeros_like(depth), reduction="none")).sum((1, 2))
    near = (bell / bell.amax((1, 2), keepdim=True).clamp(min=LEAST) * logs.exp()).sum((1, 2))
    of_failure = (1.0 - held) * -torch.log((1.0 - near).clamp(min=LEAST))
    place, depth = (v.sum() / held.sum().clamp(min=1.0) for v in (of_place, of_depth))
    total = place + DEPTH_WEIGHT * depth + of_failure.mean() + CHANGE_WEIGHT * change[:, 0].square().mean()
    return Losses(total, place, depth)
