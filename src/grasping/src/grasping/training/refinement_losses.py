"""What training of the second network makes small.

Of a person's grasp that held: the cross-entropy between a softmax over all pixels and a bell about the person's pixel;
under that bell, 1 - cos of twice the error of the angle, and Huber losses of depth and tilt. Of one that failed: the
mass of the softmax there. Of a synthetic scene: the softmax's mass where nothing can be grasped, and angle and opening
where something can. Everywhere: a little of the change itself.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F

from grasping.training.refinement_batches import Targets

SHARPNESS = 20.0
"""Logits of the softmax by quality."""
ANGLE_WEIGHT, DEPTH_WEIGHT, TILT_WEIGHT, SCENE_WEIGHT, WIDTH_WEIGHT, CHANGE_WEIGHT = 1.0, 0.5, 0.5, 1.0, 20.0, 0.02
DEPTH_SCALE_M, TILT_SCALE_RAD = 0.01, 0.17
LEAST = 1e-6


class Losses(NamedTuple):
    """Means over the pictures that teach them; `total` is the weighted sum."""

    total: torch.Tensor
    place: torch.Tensor
    angle: torch.Tensor
    depth: torch.Tensor
    tilt: torch.Tensor
    scene: torch.Tensor


def losses(maps: torch.Tensor, change: torch.Tensor, target: Targets) -> Losses:
    """Returns the losses of what the network adds.

    Args:
        maps: the network's input, shape (n, 5, h, w).
        change: its output, shape (n, 7, h, w).
        target: what it should be.
    """
    quality, cos, sin, width = (maps[:, :4] + change[:, :4]).unbind(1)
    logs = F.log_softmax(SHARPNESS * quality.flatten(1), dim=1).view_as(quality)
    person, held = 1.0 - target.is_scene, target.held * (1.0 - target.is_scene)
    bell = target.place
    agreement = _cos_of_twice(cos, sin, target.angle[:, None, None])
    depth = (maps[:, 4] - change[:, 4] - target.height[:, None, None]) / DEPTH_SCALE_M
    tilt = (change[:, 5:] - target.tilt[:, :, None, None]) / TILT_SCALE_RAD
    of_place = held * (bell * (torch.log(bell.clamp(min=LEAST)) - logs)).sum((1, 2))
    near = (bell / bell.amax((1, 2), keepdim=True).clamp(min=LEAST) * logs.exp()).sum((1, 2))
    of_failure = (person - held) * -torch.log((1.0 - near).clamp(min=LEAST))
    of_angle = held * (bell * (1.0 - agreement)).sum((1, 2))
    of_depth = held * (bell * _huber(depth)).sum((1, 2))
    of_tilt = held * (bell[:, None] * _huber(tilt)).sum((1, 2, 3))
    can = target.graspable
    some = can.sum((1, 2)).clamp(min=1.0)
    mass = torch.logsumexp(logs.masked_fill(can == 0.0, -1e9).flatten(1), dim=1)
    seen = target.is_scene * (can.sum((1, 2)) > 0)
    scene_angle = (can * (1.0 - _cos_of_twice(cos, sin, target.grasp_angle))).sum((1, 2)) / some
    scene_width = (can * (width - target.grasp_width) ** 2).sum((1, 2)) / some
    of_scene = seen * (-mass + ANGLE_WEIGHT * scene_angle + WIDTH_WEIGHT * scene_width)
    held_count, person_count, scenes = (v.sum().clamp(min=1.0) for v in (held, person, target.is_scene))
    parts = [v.sum() / held_count for v in (of_place, of_angle, of_depth, of_tilt)] + [of_scene.sum() / scenes]
    weights = (1.0, ANGLE_WEIGHT, DEPTH_WEIGHT, TILT_WEIGHT, SCENE_WEIGHT * float(scenes) / len(maps))
    total = sum(w * p for w, p in zip(weights, parts)) + of_failure.sum() / person_count
    return Losses(total + CHANGE_WEIGHT * change[:, :4].square().mean(), *parts)


def _cos_of_twice(cos: torch.Tensor, sin: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    """Returns the cosine of twice the difference between the maps' angle and another [rad]."""
    length = torch.sqrt(cos**2 + sin**2 + LEAST)
    return (cos * torch.cos(2.0 * angle) + sin * torch.sin(2.0 * angle)) / length


def _huber(x: torch.Tensor) -> torch.Tensor:
    return F.huber_loss(x, torch.zeros_like(x), reduction="none")
