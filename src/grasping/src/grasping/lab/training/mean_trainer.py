"""The base of the trainers: a network, its optimiser, and the running mean of its weights, which is what is kept."""

from __future__ import annotations

import copy
from typing import Any, Generic, TypeVar

import torch
from torch import nn

LONGEST_GRADIENT = 1.0
CPU = torch.device("cpu")

Network = TypeVar("Network", bound=nn.Module)


class MeanTrainer(Generic[Network]):
    """A network in training.

    Attributes:
        network: the trained one.
        mean: the same network with the running mean of the weights: usable at any time.
        step: the number of steps so far.
        steps: the number of steps of the whole training.
    """

    def __init__(self, network: Network, optimiser: torch.optim.Optimizer, memory: float, steps: int) -> None:
        """Takes the network before its first step; `memory` is the weight of the old mean in the new one."""
        self.network = network
        self.mean = copy.deepcopy(network)
        self.step = 0
        self.steps = steps
        self._optimiser = optimiser
        self._memory = memory

    def rate(self) -> float:
        """Returns the learning rate of the next step."""
        raise NotImplementedError

    def train(self, data: Any) -> float:
        """Takes one step and returns its loss; the batch depends on the seed and the step alone."""
        raise NotImplementedError

    def validate(self, data: Any) -> dict[str, float]:
        """Returns the losses of the mean network, `validation` the total, and a metric."""
        raise NotImplementedError

    def descend(self, loss: torch.Tensor) -> float:
        """Takes one step of the optimiser down a loss of the network; returns the loss."""
        for group in self._optimiser.param_groups:
            group["lr"] = self.rate()
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), LONGEST_GRADIENT)
        self._optimiser.step()
        memory = min(self._memory, (self.step + 1) / (self.step + 10))
        with torch.no_grad():
            for kept, new in zip(self.mean.parameters(), self.network.parameters()):
                kept.lerp_(new, 1.0 - memory)
        self.step += 1
        return loss.item()

    def state(self) -> dict:
        """Returns the checkpoint for `resume`."""
        return {
            "step": self.step,
            "network": self.network.state_dict(),
            "mean": self.mean.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }

    def resume(self, state: dict) -> None:
        """Continues from a checkpoint of `state`."""
        self.network.load_state_dict(state["network"])
        self.mean.load_state_dict(state["mean"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]
