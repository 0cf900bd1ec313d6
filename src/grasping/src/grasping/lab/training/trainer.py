"""The training of a grasp network as steps: each takes a batch and leaves the weights a little better.

Adam with a constant rate after a short warm-up and a linear decay at the end, and beside it the running mean of the
weights, which is what is kept: it is good at any time, so that training may stop or resume as the machine allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from grasping.lab.training.batches import MapTargets, Samples, batch, random_batch
from grasping.lab.training.losses import losses
from grasping.lab.training.mean_trainer import CPU, MeanTrainer
from grasping.network.networks import NETWORKS


@dataclass(frozen=True)
class NetworkTraining:
    """How to train."""

    network: str = "ggcnn2"  # name in `NETWORKS`
    steps: int = 6000  # in all; the last `decay` share of them lowers the rate to zero
    count: int = 16  # windows a step
    side: int = 156  # of the windows [px]
    rate: float = 1.5e-3  # learning rate
    warm_up: int = 200  # steps
    decay: float = 0.25  # share of the steps
    memory: float = 0.998  # of the mean of the weights, a step
    seed: int = 1  # of weights and batches
    half: bool = True  # compute in bfloat16, which is faster where the device knows it


class NetworkTrainer(MeanTrainer[nn.Module]):
    """The training of a grasp network."""

    def __init__(self, settings: NetworkTraining, device: torch.device = CPU) -> None:
        """Makes the trainer on a device."""
        self.settings, self.device = settings, device
        torch.manual_seed(settings.seed)
        network = NETWORKS[settings.network]()
        network.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in torch's types
        super().__init__(network, torch.optim.Adam(network.parameters(), lr=settings.rate), settings.memory)

    def rate(self) -> float:
        """Returns the learning rate of the next step."""
        s = self.settings
        left = (s.steps - self.step) / max(1.0, s.decay * s.steps)
        return s.rate * min(1.0, (self.step + 1) / s.warm_up, max(0.0, left))

    def train(self, samples: Samples) -> float:
        """Does one step and returns its loss; the batch depends on the seed and the step alone."""
        rng = np.random.default_rng([self.settings.seed, self.step])
        depth, target = self._here(random_batch(samples, rng, self.settings.count, self.settings.side))
        self.network.train()
        return self.descend(losses(self._maps(self.network, depth), target).total, self.rate())

    def validate(self, samples: Samples) -> dict[str, float]:
        """Returns the losses of the mean network on whole images, and the share of best pixels that are grasps."""
        rows = []
        for i in range(len(samples["depth"])):
            depth, target = self._here(batch({name: values[i : i + 1] for name, values in samples.items()}))
            with torch.no_grad():
                maps = self._maps(self.mean, depth)
            found = losses(maps, target)
            rows.append([*(v.item() for v in found), _best_is_grasp(maps.float(), target)])
        names = ("validation", "quality", "angle", "width", "hits")
        return dict(zip(names, np.mean(rows, axis=0).tolist()))

    def _here(self, made: tuple[torch.Tensor, MapTargets]) -> tuple[torch.Tensor, MapTargets]:
        depth, target = made
        return depth.to(self.device), MapTargets(*(value.to(self.device) for value in target))

    def _maps(self, network: nn.Module, depth: torch.Tensor) -> torch.Tensor:
        with torch.autocast(self.device.type, dtype=torch.bfloat16, enabled=self.settings.half):
            maps: torch.Tensor = network(depth.to(memory_format=torch.channels_last))
        return maps


def _best_is_grasp(maps: torch.Tensor, target: MapTargets) -> float:
    """Returns 1 where the pixel of highest quality is a grasp whose angle is right within 30 degrees, else 0."""
    i = int(maps[0, 0].argmax())
    cos, sin = maps[0, 1].flatten()[i], maps[0, 2].flatten()[i]
    agreement = cos * target.cos.flatten()[i] + sin * target.sin.flatten()[i]
    right = agreement > 0.5 * torch.hypot(cos, sin)  # cos of twice 30 degrees
    return float(right & target.graspable.flatten()[i])
