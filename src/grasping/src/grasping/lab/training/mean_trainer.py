"""What all trainings share: a network, the running mean of its weights, which is what is kept, and the optimiser."""

from __future__ import annotations

import copy
from typing import Generic, TypeVar

import torch
from torch import nn

LONGEST_GRADIENT = 1.0
CPU = torch.device("cpu")

Network = TypeVar("Network", bound=nn.Module)


class MeanTrainer(Generic[Network]):
    """A network in training.

    Attributes:
        network: that is trained.
        mean: the same with the running mean of its weights: it is good at any time.
        step: how many there were.
    """

    def __init__(self, network: Network, optimiser: torch.optim.Optimizer, memory: float) -> None:
        """Takes the network before its first step; `memory` is of the mean, a step."""
        self.network = network
        self.mean = copy.deepcopy(network)
        self.step = 0
        self._optimiser = optimiser
        self._memory = memory

    def descend(self, loss: torch.Tensor, rate: float) -> float:
        """Does one step down a loss of the network, which it returns, at a learning rate."""
        for group in self._optimiser.param_groups:
            group["lr"] = rate
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
        """Returns all that `resume` needs."""
        return {
            "step": self.step,
            "network": self.network.state_dict(),
            "mean": self.mean.state_dict(),
            "optimiser": self._optimiser.state_dict(),
        }

    def resume(self, state: dict) -> None:
        """Goes on where `state` was taken."""
        self.network.load_state_dict(state["network"])
        self.mean.load_state_dict(state["mean"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step = state["step"]
