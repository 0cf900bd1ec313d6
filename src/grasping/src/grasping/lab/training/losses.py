"""What training makes small: errors of the maps, each counted only where its target means something.

The published loss counts all maps at all pixels, so that the background teaches an angle of zero; here angle and
width count only where there is a grasp.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from grasping.lab.training.batches import MapTargets

QUALITY_WEIGHT = 10.0
GRASP_WEIGHT = 4.0
"""How much more a pixel of quality 1 counts than the background."""
ANGLE_WEIGHT = 0.5
WIDTH_WEIGHT = 2.0


class MapLosses(NamedTuple):
    """Mean squared errors; `total` is their weighted sum."""

    total: torch.Tensor
    quality: torch.Tensor
    angle: torch.Tensor
    width: torch.Tensor


def losses(maps: torch.Tensor, target: MapTargets) -> MapLosses:
    """Returns the losses of the network's output, shape (n, 4, h, w)."""
    quality, cos, sin, width = maps.float().unbind(1)
    weight = target.known * (1.0 + GRASP_WEIGHT * target.quality)
    of_quality = (weight * (quality - target.quality) ** 2).sum() / target.known.sum().clamp(min=1)
    graspable = target.graspable
    count = graspable.sum().clamp(min=1)
    of_angle = (graspable * ((cos - target.cos) ** 2 + (sin - target.sin) ** 2)).sum() / count
    of_width = (graspable * (width - target.width) ** 2).sum() / count
    total = QUALITY_WEIGHT * of_quality + ANGLE_WEIGHT * of_angle + WIDTH_WEIGHT * of_width
    return MapLosses(total, of_quality, of_angle, of_width)
