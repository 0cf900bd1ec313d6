"""The training of the second network as steps; it is over when held-out episodes say so.

AdamW with a linear decay of the rate. What is kept is the running mean of the weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from grasping.refinement import FEATURES, SHRINK, RefinementNetwork
from grasping.training.mean_trainer import MeanTrainer
from grasping.training.refinement_batches import batch, random_batch
from grasping.training.refinement_examples import Example, Offset, Scene
from grasping.training.refinement_losses import Losses, losses

VALIDATION_BATCH = 16


@dataclass(frozen=True)
class Settings:
    """How to train.

    Attributes:
        steps: most steps; the rate falls to zero over them.
        count: pictures a step.
        rate: learning rate at first.
        weight_decay: of AdamW.
        memory: of the mean of the weights, a step.
        features: of the network, each in four attitudes.
        patience: validations without a better one, after which training ends.
        seed: of weights and batches.
    """

    steps: int = 3000
    count: int = 8
    rate: float = 3e-3
    weight_decay: float = 1e-4
    memory: float = 0.99
    features: int = FEATURES
    patience: int = 8
    seed: int = 1


class Trainer(MeanTrainer):
    """The training of the second network."""

    def __init__(self, settings: Settings, offset: Offset) -> None:
        """Makes the trainer; `offset` is the person's constant one."""
        self.settings = settings
        torch.manual_seed(settings.seed)
        network = RefinementNetwork(settings.features)
        network.offset[:] = torch.tensor([offset.x, offset.y, offset.tilt_x, offset.tilt_y])
        optimiser = torch.optim.AdamW(network.parameters(), lr=settings.rate, weight_decay=settings.weight_decay)
        super().__init__(network, optimiser, settings.memory)

    @property
    def offset(self) -> np.ndarray:
        """The constant offset, as the network keeps it, shape (4,)."""
        return self.network.offset.numpy().astype(float)

    def train(self, examples: list[Example], scenes: list[Scene]) -> float:
        """Does one step and returns its loss; the batch depends on the seed and the step alone."""
        s = self.settings
        rng = np.random.default_rng([s.seed, self.step])
        maps, target = random_batch(examples, scenes, self.offset, rng, s.count)
        self.network.train()
        loss = losses(maps, self.network(maps), target).total
        return self.descend(loss, s.rate * max(0.0, 1.0 - self.step / s.steps))

    def validate(self, examples: list[Example]) -> dict[str, float]:
        """Returns the losses of the mean network, and how far its best pixel is from the person's, the median [px of
        the network's picture]."""
        held = [e for e in examples if e.held]
        rows, misses, counts = [], [], []
        for i in range(0, len(held), VALIDATION_BATCH):
            part = held[i : i + VALIDATION_BATCH]
            maps, target = batch(part, self.offset)
            with torch.no_grad():
                change = self.mean(maps)
            rows.append([v.item() for v in losses(maps, change, target)])
            counts.append(len(part))
            misses += _misses(maps[:, 0] + change[:, 0], target.place)
        found = dict(zip(("validation", *Losses._fields[1:]), np.average(rows, axis=0, weights=counts).tolist()))
        del found["scene"]
        return {**found, "miss": float(np.median(misses))}


def _misses(quality: torch.Tensor, place: torch.Tensor) -> list[float]:
    """Returns the distances between the highest pixels of two maps, shape (n, h, w) [px of the network's picture]."""
    side = quality.shape[-1]
    a, b = quality.flatten(1).argmax(1), place.flatten(1).argmax(1)
    return (SHRINK * torch.hypot((a // side - b // side).float(), (a % side - b % side).float())).tolist()
