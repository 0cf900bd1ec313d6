"""The network that says of each hypothesis how likely it lifts: two hidden layers over what `hand_view` sees."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import nn

from common.config import is_number, parse
from common.errors import RigError
from grasping.network.maps import HANDS, PARALLEL
from grasping.network.torch_files import content_of, give
from grasping.poses.gripper import GRIPPER, Gripper
from grasping.poses.hand_view import FEATURES

HIDDEN = (128, 64)
SCHEMA = 1


class LiftNetwork(nn.Module):
    """Returns the logit of a lift of features, shape (n, FEATURES) to (n,), of the `hand` that it was trained for, as
    the `gripper` describes it, and of the maps of the GG-CNN whose file has the SHA-256 `ggcnn`. `trusts`: probability
    of a lift above which GG-CNN's own grasp is taken; 1: never."""

    temperature: torch.Tensor

    def __init__(self, hand: str = PARALLEL, ggcnn: str = "", gripper: Gripper = GRIPPER, trusts: float = 1.0) -> None:
        super().__init__()
        self.hand, self.ggcnn, self.gripper, self.trusts = hand, ggcnn, gripper, trusts
        first, second = HIDDEN
        self.layers = nn.Sequential(
            nn.Linear(FEATURES, first), nn.ReLU(), nn.Linear(first, second), nn.ReLU(), nn.Linear(second, 1)
        )
        self.register_buffer("temperature", torch.ones(()))  # divides the logits: found on scenes of the validation

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        logits: torch.Tensor = self.layers(features)[:, 0] / self.temperature
        return logits


def lift_logits(network: LiftNetwork, features: np.ndarray) -> np.ndarray:
    """Returns the logits of lifts, shape (n,), of features, shape (n, FEATURES), float32."""
    with torch.no_grad():
        found: np.ndarray = network(torch.from_numpy(features)).numpy()
    return found


def saved(network: LiftNetwork) -> dict[str, Any]:
    of = {"hand": network.hand, "ggcnn": network.ggcnn, "gripper": asdict(network.gripper), "trusts": network.trusts}
    return {"schema": SCHEMA, "features": FEATURES, **of, "state": network.state_dict()}


def loaded(data: bytes) -> LiftNetwork:
    """Returns the network from the content of a weight file; raises RigError for any other content."""
    try:
        content = content_of(data, schema=SCHEMA, features=FEATURES)
        hand, ggcnn = content.get("hand"), content.get("ggcnn")
        if hand not in HANDS or not isinstance(ggcnn, str):
            raise RigError(f"it is of the hand {hand!r} and of GG-CNN's file {ggcnn!r}")
        trusts = content.get("trusts", 1.0)
        if not is_number(trusts) or not 0.0 <= trusts <= 1.0:
            raise RigError(f"it trusts GG-CNN above {trusts!r}, which must be between 0 and 1")
        network = LiftNetwork(hand, ggcnn, parse(Gripper, content.get("gripper", {}), "gripper/"), float(trusts))
        give(network, content.get("state"))
        if network.temperature <= 0.0:
            raise RigError(f"it divides the logits by {float(network.temperature):g}, which must be above 0")
    except RigError as error:
        sentence = str(error).rstrip(".")
        raise RigError(f"The file holds no weights of the network of lifts: {sentence}.") from error
    return network.eval()
