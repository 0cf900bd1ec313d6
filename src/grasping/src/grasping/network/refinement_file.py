"""Weight files of the refinement network: a torch state dict with a description of the rig that it was trained on.

A refinement network fits one first network, view, crop, table and hand: with another crop a constant offset in pixels
is another distance, and another first network has other maps. So a file is refused where they differ. Values that a
file does not contain are not compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import torch

from grasping.network import weights
from grasping.network.depth_image import CAMERA, TABLE, VIEWS
from grasping.network.refinement import HIDDEN, MapRefiner, RefinementNetwork
from grasping.network.weights import WeightsError

VERSION = 2
ABOUT = "about"  # entry of a weight file beside the weights: the characters' codes of a JSON text
TABLE_KEYS = ("extent", "distance")  # of the settings of the view from above, those that make its image another one


@dataclass(frozen=True)
class Origin:
    """The rig of episodes, as far as a refinement network depends on it; None where that is unknown or of no matter."""

    view: str | None = None  # in which the network sees, a name in `view.VIEWS`
    crop: dict[str, Any] | None = None  # of the camera's image, in its own view
    table: dict[str, Any] | None = None  # extent and distance [m], in the view from above
    network: str | None = None  # SHA-256 of the first network's weight file
    robot: str | None = None  # which arm
    hand: list[list[float]] | None = None  # the grasp in the tool, the rows of a 4 x 4 matrix [m]

    @classmethod
    def of(cls, configuration: Mapping[str, Any]) -> Origin:
        """Returns the origin that a rig's configuration means, as `dataset.configuration` has it."""
        view = configuration.get("view", CAMERA)
        table = configuration.get("table")
        return cls(
            view=view,
            crop=configuration.get("crop") if view == CAMERA else None,
            table={key: table[key] for key in TABLE_KEYS} if view == TABLE and table else None,
            network=configuration.get("weights"),
            robot=configuration.get("kuka", {}).get("robot"),
            hand=configuration.get("T_tool_grasp"),
        )

    def mismatch(self, other: Origin) -> str:
        """Returns why what was learned here is wrong there, a clause, or an empty string; skips unknown parts."""
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if None not in (ours, theirs) and ours != theirs:
                return f"learned with {field.name}: {_text(ours)}, but {field.name} is {_text(theirs)}"
        return ""


def content(network: RefinementNetwork, origin: Origin) -> dict[str, torch.Tensor]:
    """Returns what a weight file holds."""
    return _with_about(network.state_dict(), origin)


def taste(network: RefinementNetwork, origin: Origin) -> dict[str, torch.Tensor]:
    """Returns what a weight file without anything that has the axes of a view holds: it fits any hand and view."""
    return _with_about(network.without_axes(), Origin(network=origin.network))


def load(data: bytes, sha256: str | None = None) -> tuple[MapRefiner, Origin]:
    """Returns a weight file's refinement network and the rig of its training; runs no code of the file. Raises
    WeightsError for another `sha256` (if given, hexadecimal), no torch file, another version, or another network.
    """
    weights.checked_sha256(data, sha256)
    state = weights.torch_state(data)
    about = _about(state.pop(ABOUT, None))
    if about.get("version") != VERSION:
        raise WeightsError(
            f"The weight file holds no refinement network of version {VERSION}: train it again on the same episodes "
            "with train_refinement.py."
        )
    hidden = len(state.get("first.weight", ())) or HIDDEN
    network = weights.filled(RefinementNetwork(hidden), "the refinement network", state)
    return MapRefiner(network), _origin(about)


def _with_about(state: dict[str, torch.Tensor], origin: Origin) -> dict[str, torch.Tensor]:
    codes = json.dumps({"version": VERSION, **asdict(origin)}, sort_keys=True).encode()
    return {**{name: value.cpu() for name, value in state.items()}, ABOUT: torch.tensor(list(codes))}


def _about(codes: torch.Tensor | None) -> dict[str, Any]:
    """Returns the description in a weight file; empty where it is missing or unreadable."""
    if codes is None:
        return {}
    try:
        found = json.loads(bytes(int(code) for code in codes.tolist()))
    except (TypeError, ValueError, OverflowError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _origin(about: dict[str, Any]) -> Origin:
    names = {f.name for f in fields(Origin)}
    if about.keys() - {"version"} != names or about["view"] not in (None, *VIEWS):
        raise WeightsError("The weight file does not say of what rig it is, or names a view that is not known.")
    return Origin(**{name: about[name] for name in names})


def _text(value: object) -> str:
    """Returns a value as a message shows it; of a hash its beginning."""
    text = str(value)
    return f"{text[:12]}..." if isinstance(value, str) and len(value) == 64 else text
