"""What training of the refinement network makes small: how improbable the operator's grasps are.

Of a grasp that held: the cross-entropy between a softmax over all pixels and a bell about the operator's pixel, and
under that bell the negative log-likelihoods of depth, turn, opening and lean, but for a constant. Of one that failed:
the mass of the softmax there. Everywhere: a little of the quality's change itself.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
import torch.nn.functional as F

from grasping.lab.training.refinement_batches import RefinementTargets
from grasping.network.refinement import (
    COS,
    DEPTH_M,
    HEIGHT,
    LEAN_X,
    LEAN_Y,
    OPENING,
    OPENING_UNITS,
    SHARPNESS,
    SIN,
    TILT_RAD,
    RefinementOutput,
)

POSE_WEIGHT, CHANGE_WEIGHT = 0.3, 0.02
"""Of each likelihood beside the place's, and of the quality's change."""
LEAST = 1e-6


class RefinementLosses(NamedTuple):
    """Means over the images that teach them; `total` is the weighted sum."""

    total: torch.Tensor
    place: torch.Tensor
    depth: torch.Tensor
    turn: torch.Tensor
    opening: torch.Tensor
    tilt: torch.Tensor


def losses(seen: torch.Tensor, said: torch.Tensor, target: RefinementTargets) -> RefinementLosses:
    """Returns the losses of what the network says.

    Args:
        seen: its input, shape (n, LEAN_Y + 1, h, w).
        said: its output, shape (n, len(CHANGES), h, w).
    """
    change = RefinementOutput.of(said)
    quality = seen[:, 0] + change.quality
    logs = F.log_softmax(SHARPNESS * quality.flatten(1), dim=1).view_as(quality)
    held, bell = target.held, target.place
    of_place = held * (bell * (torch.log(bell.clamp(min=LEAST)) - logs)).sum((1, 2))
    near = (bell / bell.amax((1, 2), keepdim=True).clamp(min=LEAST) * logs.exp()).sum((1, 2))
    of_failure = (1.0 - held) * -torch.log((1.0 - near).clamp(min=LEAST))
    opens = held * torch.isfinite(target.opening)
    rest = [
        _mean((bell * surprise).sum((1, 2)), taught)
        for surprise, taught in (
            (of_depth(seen, change, target), held),
            (of_turn(seen, change, target), held),
            (of_opening(seen, change, target), opens),
            (of_tilt(seen, change, target), held),
        )
    ]
    place = _mean(of_place, held)
    total = place + POSE_WEIGHT * sum(rest) + of_failure.mean() + CHANGE_WEIGHT * change.quality.square().mean()
    return RefinementLosses(total, place, *rest)


def of_depth(seen: torch.Tensor, change: RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's depth is at each pixel, shape (n, h, w)."""
    off = seen[:, HEIGHT] - change.depth - _of_all(target.height)
    return off.abs() / change.depth_scale + torch.log(change.depth_scale / DEPTH_M)


def of_turn(seen: torch.Tensor, change: RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's angle is at each pixel, shape (n, h, w): von Mises of twice the angle."""
    cos, sin, c, s = _of_all(target.cos), _of_all(target.sin), seen[:, COS], seen[:, SIN]
    along, across = c * cos + s * sin, c * sin - s * cos
    concentration = torch.sqrt(change.turn_cos.square() + change.turn_sin.square() + LEAST)
    scale = torch.log(torch.special.i0e(concentration)) + concentration
    return scale - change.turn_cos * along - change.turn_sin * across


def of_opening(seen: torch.Tensor, change: RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's opening is at each pixel, shape (n, h, w); no matter where unknown."""
    off = seen[:, OPENING] + change.opening - _of_all(torch.nan_to_num(target.opening))
    return off.abs() / change.opening_scale + torch.log(change.opening_scale / OPENING_UNITS)


def of_tilt(seen: torch.Tensor, change: RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's lean is at each pixel, shape (n, h, w)."""
    x = change.tilt_x + change.follow * seen[:, LEAN_X] - _of_all(target.tilt_x)
    y = change.tilt_y + change.follow * seen[:, LEAN_Y] - _of_all(target.tilt_y)
    off = torch.sqrt(x.square() + y.square() + LEAST)
    return off / change.tilt_scale + 2.0 * torch.log(change.tilt_scale / TILT_RAD)


def _of_all(values: torch.Tensor) -> torch.Tensor:
    return values[:, None, None]


def _mean(values: torch.Tensor, taught: torch.Tensor) -> torch.Tensor:
    return (taught * values).sum() / taught.sum().clamp(min=1.0)
