"""Trains the refinement network with AdamW and a linear decay of the learning rate, until held-out episodes stop it.

Of a grasp that held it makes small the cross-entropy between a softmax over all pixels and a bell about the operator's
pixel, and under that bell the negative log-likelihoods of depth, turn, opening and lean, but for a constant; of one
that failed, the mass of the softmax there; everywhere, a little, the quality's change itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

from grasping.lab.training.refinement_examples import Example, OperatorOffset, RefinementTargets, batch
from grasping.lab.training.trainer import CPU, MeanTrainer
from grasping.network import refinement

POSE_WEIGHT, CHANGE_WEIGHT = 0.3, 0.02  # of each likelihood beside the place's, and of the quality's change
LEAST = 1e-6
VALIDATION_BATCH = 16


class RefinementLosses(NamedTuple):
    """Means over the images that teach them; `total` is the weighted sum."""

    total: torch.Tensor
    place: torch.Tensor
    depth: torch.Tensor
    turn: torch.Tensor
    opening: torch.Tensor
    tilt: torch.Tensor


def losses(seen: torch.Tensor, said: torch.Tensor, target: RefinementTargets) -> RefinementLosses:
    """Returns the losses of `said`, shape (n, len(CHANGES), h, w), for the input, shape (n, LEAN_Y + 1, h, w)."""
    change = refinement.RefinementOutput.of(said)
    quality = seen[:, 0] + change.quality
    logs = F.log_softmax(refinement.SHARPNESS * quality.flatten(1), dim=1).view_as(quality)
    held, bell = target.held, target.place
    of_place = held * (bell * (torch.log(bell.clamp(min=LEAST)) - logs)).sum((1, 2))
    near = (bell / bell.amax((1, 2), keepdim=True).clamp(min=LEAST) * logs.exp()).sum((1, 2))
    of_failure = (1.0 - held) * -torch.log((1.0 - near).clamp(min=LEAST))
    opens = held * torch.isfinite(target.opening)
    parts = ((of_depth, held), (of_turn, held), (of_opening, opens), (of_tilt, held))
    rest = [_mean((bell * improbable(seen, change, target)).sum((1, 2)), taught) for improbable, taught in parts]
    place = _mean(of_place, held)
    total = place + POSE_WEIGHT * sum(rest) + of_failure.mean() + CHANGE_WEIGHT * change.quality.square().mean()
    return RefinementLosses(total, place, *rest)


def of_depth(seen: torch.Tensor, change: refinement.RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's depth is at each pixel, shape (n, h, w)."""
    off = seen[:, refinement.HEIGHT] - change.depth - _of_all(target.height)
    return off.abs() / change.depth_scale + torch.log(change.depth_scale / refinement.DEPTH_M)


def of_turn(seen: torch.Tensor, change: refinement.RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's angle is at each pixel, shape (n, h, w): von Mises of twice the angle."""
    cos, sin, c, s = _of_all(target.cos), _of_all(target.sin), seen[:, refinement.COS], seen[:, refinement.SIN]
    along, across = c * cos + s * sin, c * sin - s * cos
    concentration = torch.sqrt(change.turn_cos.square() + change.turn_sin.square() + LEAST)
    scale = torch.log(torch.special.i0e(concentration)) + concentration
    return scale - change.turn_cos * along - change.turn_sin * across


def of_opening(seen: torch.Tensor, change: refinement.RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's opening is at each pixel, shape (n, h, w); no matter where unknown."""
    off = seen[:, refinement.OPENING] + change.opening - _of_all(torch.nan_to_num(target.opening))
    return off.abs() / change.opening_scale + torch.log(change.opening_scale / refinement.OPENING_UNITS)


def of_tilt(seen: torch.Tensor, change: refinement.RefinementOutput, target: RefinementTargets) -> torch.Tensor:
    """Returns how improbable the operator's lean is at each pixel, shape (n, h, w)."""
    x = change.tilt_x + change.follow * seen[:, refinement.LEAN_X] - _of_all(target.tilt_x)
    y = change.tilt_y + change.follow * seen[:, refinement.LEAN_Y] - _of_all(target.tilt_y)
    off = torch.sqrt(x.square() + y.square() + LEAST)
    return off / change.tilt_scale + 2.0 * torch.log(change.tilt_scale / refinement.TILT_RAD)


def _of_all(values: torch.Tensor) -> torch.Tensor:
    return values[:, None, None]


def _mean(values: torch.Tensor, taught: torch.Tensor) -> torch.Tensor:
    return (taught * values).sum() / taught.sum().clamp(min=1.0)


@dataclass(frozen=True)
class RefinementTraining:
    """How to train."""

    steps: int = 600  # at most; the learning rate falls to zero over them
    count: int = 16  # images per step
    rate: float = 1e-2  # initial learning rate
    weight_decay: float = 1e-4  # of AdamW
    memory: float = 0.98  # of the running mean of the weights, per step
    hidden: int = refinement.HIDDEN  # units of each of the network's two inner layers
    patience: int = 8  # training stops after this many validations without a better one
    seed: int = 1  # of weights and batches


def refinement_trainer(
    settings: RefinementTraining, offset: OperatorOffset, device: torch.device = CPU
) -> MeanTrainer[refinement.RefinementNetwork]:
    """Returns the training of the refinement network on lists of examples; its metric is how far its best pixel is from
    the operator's, the median [px of the network's image]. `offset`: the operator's constant one.
    """
    s = settings
    torch.manual_seed(s.seed)
    network = refinement.RefinementNetwork(s.hidden)
    network.offset[:] = torch.tensor([getattr(offset, name) for name in refinement.AXES])
    network.to(device)

    def made(examples: list[Example]) -> tuple[torch.Tensor, RefinementTargets]:
        seen, target = batch(examples, offset)
        return seen.to(device), target.to(device)

    def loss(network: refinement.RefinementNetwork, examples: list[Example], step: int) -> torch.Tensor:
        chosen = np.random.default_rng([s.seed, step]).integers(0, len(examples), s.count)
        seen, target = made([examples[i] for i in chosen])
        return losses(seen, network(seen), target).total

    def validate(network: refinement.RefinementNetwork, examples: list[Example]) -> dict[str, float]:
        held = [e for e in examples if e.held]
        rows, misses, counts = [], [], []
        for i in range(0, len(held), VALIDATION_BATCH):
            part = held[i : i + VALIDATION_BATCH]
            seen, target = made(part)
            with torch.no_grad():
                change = network(seen)
            rows.append([v.item() for v in losses(seen, change, target)])
            counts.append(len(part))
            misses += _misses(seen[:, 0] + change[:, 0], target.place)
        names = ("validation", *RefinementLosses._fields[1:])
        return {**dict(zip(names, np.average(rows, axis=0, weights=counts).tolist())), "miss": float(np.median(misses))}

    optimiser = torch.optim.AdamW(network.parameters(), lr=s.rate, weight_decay=s.weight_decay)

    def rate(step: int) -> float:
        return s.rate * max(0.0, 1.0 - step / s.steps)

    return MeanTrainer(network, optimiser, s.memory, s.steps, rate, loss, validate)


def _misses(quality: torch.Tensor, place: torch.Tensor) -> list[float]:
    """Returns the distances between the highest pixels of two maps, shape (n, h, w) [px of the network's image]."""
    side = quality.shape[-1]
    a, b = quality.flatten(1).argmax(1), place.flatten(1).argmax(1)
    return (refinement.SHRINK * torch.hypot((a // side - b // side).float(), (a % side - b % side).float())).tolist()
