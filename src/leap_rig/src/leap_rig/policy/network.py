"""The network of a policy, and its file."""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from common.action_stream import LONGEST_S, MOST_ACTIONS, PERIODS_S
from common.config import flag, integer, parse, text
from common.errors import RigError
from grasping.network.torch_files import content_of, give
from leap_rig.policy.view import ACTION, BELOW_M, CELLS, NOTHING_M, STATE, TOUCH

SCHEMA, POINTS = 1, 8


@dataclass(frozen=True)
class PolicyAbout:
    """What a policy does, and how it came to be."""

    task: str = text()
    fps: int = integer("1/s", low=1.0 / PERIODS_S[1], high=1.0 / PERIODS_S[0])  # of its actions
    chunk: int = integer(low=1, high=MOST_ACTIONS)  # actions at once; the first one is due 1 / fps after what it saw
    episodes: int = integer(low=1)
    touch: bool = flag(absent=True)  # whether it feels
    map: bool = flag(absent=True)  # whether it sees

    def faults(self) -> list[str]:
        """Returns what keeps its actions from being taken."""
        lasts = self.chunk / self.fps
        return [f"chunk / fps is {lasts:g} s, but at most {LONGEST_S:g} s count."] if lasts > LONGEST_S else []


class PolicyNetwork(nn.Module):
    """Maps, shape (b, 52, 52), and states, shape (b, 14), to actions, shape (b, chunk, 13). From the map it takes where
    it finds what it has learned to look for, and how much of it there is."""

    state_mean: torch.Tensor
    state_sd: torch.Tensor
    action_mean: torch.Tensor
    action_sd: torch.Tensor

    def __init__(self, about: PolicyAbout) -> None:
        super().__init__()
        self.about = about
        width = 24
        self.look = nn.Sequential(
            nn.Conv2d(2, 16, 5, 1, 2), nn.ReLU(), nn.Conv2d(16, width, 5, 2, 2), nn.ReLU(),
            nn.Conv2d(width, width, 5, 1, 2), nn.ReLU(),
        )  # fmt: skip
        self.find = nn.Conv2d(width, POINTS, 1)
        self.sharpness = nn.Parameter(torch.tensor(5.0))
        self.say = nn.Sequential(
            nn.Linear(2 * POINTS + width + STATE, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(),
            nn.Linear(256, about.chunk * ACTION),
        )  # fmt: skip
        self.go = nn.Linear(2 * POINTS, about.chunk * ACTION)  # straight to a place that it sees
        for name, count in (("state", STATE), ("action", ACTION)):
            self.register_buffer(f"{name}_mean", torch.zeros(count))
            self.register_buffer(f"{name}_sd", torch.ones(count))

    def forward(self, heights: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """Returns actions that are scaled to a mean of 0 and a standard deviation of 1."""
        if not self.about.map:
            heights = torch.full_like(heights, -BELOW_M)
        there = (heights > NOTHING_M).float()
        seen = self.look(torch.stack([5.0 * heights + 1.0, there], 1))
        found = self.find(seen)
        side = found.shape[-1]
        share = functional.softmax(self.sharpness * found.flatten(2), 2).reshape(found.shape)
        places = [(share.sum(axis) * torch.linspace(-1.0, 1.0, side)).sum(2) for axis in (3, 2)]
        known = (state - self.state_mean) / self.state_sd
        if not self.about.touch:
            known = torch.cat([known[:, :-TOUCH], torch.zeros_like(known[:, -TOUCH:])], 1)
        said: torch.Tensor = self.say(torch.cat([*places, seen.amax((2, 3)), known], 1)) + self.go(torch.cat(places, 1))
        return said.reshape(-1, self.about.chunk, ACTION)

    def act(self, heights: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Returns the next actions, shape (chunk, 13), for a map, shape (52, 52), and a state, shape (14,)."""
        with torch.inference_mode():
            said = self(torch.from_numpy(heights)[None], torch.from_numpy(state)[None])[0]
            actions: np.ndarray = (said * self.action_sd + self.action_mean).double().numpy()
        return actions


def saved(network: PolicyNetwork) -> bytes:
    """Returns the content of a policy's file."""
    file = io.BytesIO()
    torch.save({"schema": SCHEMA, "cells": CELLS, "about": asdict(network.about), "state": network.state_dict()}, file)
    return file.getvalue()


def loaded(data: bytes) -> PolicyNetwork:
    """Returns the policy of a file's content; raises RigError for any other content."""
    try:
        content = content_of(data, schema=SCHEMA, cells=CELLS)
        network = PolicyNetwork(parse(PolicyAbout, content.get("about", {}), "about/"))
        give(network, content.get("state"))
    except RigError as error:
        sentence = str(error).rstrip(".")
        raise RigError(f"The file holds no policy of this release: {sentence}.") from error
    return network.eval()
