"""Trains the refinement network with AdamW and a linear decay of the learning rate, until held-out episodes stop it.

The running mean of the weights is what is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from grasping.lab.training.mean_trainer import CPU, MeanTrainer
from grasping.lab.training.refinement_batches import RefinementTargets, batch
from grasping.lab.training.refinement_examples import Example, OperatorOffset
from grasping.lab.training.refinement_losses import RefinementLosses, losses
from grasping.network.refinement import AXES, HIDDEN, SHRINK, RefinementNetwork

VALIDATION_BATCH = 16


@dataclass(frozen=True)
class RefinementTraining:
    """How to train."""

    steps: int = 600  # at most; the learning rate falls to zero over them
    count: int = 16  # images per step
    rate: float = 1e-2  # initial learning rate
    weight_decay: float = 1e-4  # of AdamW
    memory: float = 0.98  # of the running mean of the weights, per step
    hidden: int = HIDDEN  # units of each of the network's two inner layers
    patience: int = 8  # training stops after this many validations without a better one
    seed: int = 1  # of weights and batches


class RefinementTrainer(MeanTrainer[RefinementNetwork]):
    """The training of the refinement network."""

    def __init__(self, settings: RefinementTraining, offset: OperatorOffset, device: torch.device = CPU) -> None:
        """Makes the trainer on a device; `offset` is the operator's constant one."""
        self.settings, self.offset, self.device = settings, offset, device
        torch.manual_seed(settings.seed)
        network = RefinementNetwork(settings.hidden)
        network.offset[:] = torch.tensor([getattr(offset, name) for name in AXES])
        network.to(device)
        optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.weight_decay)
        super().__init__(network, optimiser, settings.memory, settings.steps)

    def rate(self) -> float:
        return self.settings.rate * max(0.0, 1.0 - self.step / self.settings.steps)

    def train(self, examples: list[Example]) -> float:
        s = self.settings
        chosen = np.random.default_rng([s.seed, self.step]).integers(0, len(examples), s.count)
        seen, target = self._batch([examples[i] for i in chosen])
        return self.descend(losses(seen, self.network(seen), target).total)

    def validate(self, examples: list[Example]) -> dict[str, float]:
        """Returns the losses of the mean network, and how far its best pixel is from the operator's, the median [px of
        the network's image]."""
        held = [e for e in examples if e.held]
        rows, misses, counts = [], [], []
        for i in range(0, len(held), VALIDATION_BATCH):
            part = held[i : i + VALIDATION_BATCH]
            seen, target = self._batch(part)
            with torch.no_grad():
                change = self.mean(seen)
            rows.append([v.item() for v in losses(seen, change, target)])
            counts.append(len(part))
            misses += _misses(seen[:, 0] + change[:, 0], target.place)
        found = dict(
            zip(("validation", *RefinementLosses._fields[1:]), np.average(rows, axis=0, weights=counts).tolist())
        )
        return {**found, "miss": float(np.median(misses))}

    def _batch(self, examples: list[Example]) -> tuple[torch.Tensor, RefinementTargets]:
        seen, target = batch(examples, self.offset)
        return seen.to(self.device), target.to(self.device)


def _misses(quality: torch.Tensor, place: torch.Tensor) -> list[float]:
    """Returns the distances between the highest pixels of two maps, shape (n, h, w) [px of the network's image]."""
    side = quality.shape[-1]
    a, b = quality.flatten(1).argmax(1), place.flatten(1).argmax(1)
    return (SHRINK * torch.hypot((a // side - b // side).float(), (a % side - b % side).float())).tolist()
