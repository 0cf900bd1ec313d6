"""Files of tastes: a torch state dict of one taste for each kind of object, and the rig that they were learned on.

A taste fits one GG-CNN, network of lifts, view, crop, table and hand; a file is refused where they differ. Values that
a file does not contain are not compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch

from grasping.network import weights
from grasping.network.depth_image import CAMERA, TABLE, VIEWS
from grasping.network.weights import WeightsError
from grasping.poses.taste import PoseTaste, Style, nobody

VERSION = 5  # of before: the files of another way to choose
ANY_KIND = "any"  # name of what was learned from all kinds together
ABOUT = "about"  # entry of a weight file beside the weights: the characters' codes of a JSON text
TABLE_KEYS = ("extent", "distance")  # of the settings of the view from above, those that make its image another one


@dataclass(frozen=True)
class Origin:
    """The rig of episodes, as far as a taste depends on it; None where that is unknown or of no matter."""

    view: str | None = None  # in which the network sees, a name in `view.VIEWS`
    crop: dict[str, Any] | None = None  # of the camera's image, in its own view
    table: dict[str, Any] | None = None  # extent and distance [m], in the view from above
    network: str | None = None  # SHA-256 of GG-CNN's weight file
    robot: str | None = None  # which arm
    hand: list[list[float]] | None = None  # the grasp in the tool, the rows of a 4 x 4 matrix [m]
    lifts: str | None = None  # SHA-256 of the weight file of the network of lifts

    @classmethod
    def of(cls, configuration: Mapping[str, Any], lifts: str | None = None) -> Origin:
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
            lifts=lifts,
        )

    def mismatch(self, other: Origin) -> str:
        """Returns why what was learned here is wrong there, a clause, or an empty string; skips unknown parts."""
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if None not in (ours, theirs) and ours != theirs:
                return f"learned with {field.name}: {_text(ours)}, but {field.name} is {_text(theirs)}"
        return ""


class TasteFile(NamedTuple):
    """What a file holds."""

    kinds: Mapping[str, PoseTaste]  # by the kind of object, at least one
    origin: Origin


def content(of: TasteFile) -> dict[str, torch.Tensor]:
    about = {"version": VERSION, "kinds": list(of.kinds), **asdict(of.origin)}
    arrays = {
        f"{number}/{key}": torch.as_tensor(np.array(value, np.float32))
        for number, taste in enumerate(of.kinds.values())
        for key, value in _arrays(taste).items()
    }
    return {**arrays, ABOUT: torch.tensor(list(json.dumps(about, sort_keys=True).encode()))}


def load(data: bytes, sha256: str | None = None) -> TasteFile:
    """Returns what a file holds; runs no code of it. Raises WeightsError for another `sha256` (if given, hexadecimal),
    no torch file, another version, or something else in it.
    """
    weights.checked_sha256(data, sha256)
    state = weights.torch_state(data)
    about = _about(state.pop(ABOUT, None))
    if about.get("version") != VERSION:
        raise WeightsError(
            f"The weight file holds no tastes of version {VERSION}: train it again on the same episodes with "
            "train_refinement.py."
        )
    names, origin = _kinds(about), _origin(about)
    wanted = {f"{number}/{key}": value for number in range(len(names)) for key, value in _arrays(nobody()).items()}
    if others := wanted.keys() ^ state.keys():
        raise WeightsError(f"The weight file lacks or adds to tastes: {', '.join(sorted(others))}.")
    for key, value in wanted.items():
        if state[key].shape != value.shape:
            raise WeightsError(f"The array {key} has the shape {tuple(state[key].shape)} instead of {value.shape}.")
        if not torch.isfinite(state[key]).all():
            raise WeightsError("The weight file holds values that are not finite.")
        if key.endswith("/spreads") and (state[key] <= 0.0).any():
            raise WeightsError("The weight file holds standard deviations that are not positive.")
    found = {key: value.double().numpy() for key, value in state.items()}
    kinds = {}
    for number, name in enumerate(names):
        style = Style(*(found[f"{number}/style_{key}"] for key in Style._fields))
        kinds[name] = PoseTaste(found[f"{number}/weights"], found[f"{number}/miss"], style, found[f"{number}/spreads"])
    return TasteFile(kinds, origin)


def of_kind(kinds: Mapping[str, PoseTaste], name: str) -> PoseTaste:
    """Returns the taste of the kind `name`; an empty `name` means the only kind.

    Raises:
        WeightsError: the kind is unknown, or `name` is empty and there are several.
    """
    if not name and len(kinds) == 1:
        return next(iter(kinds.values()))
    if name not in kinds:
        raise WeightsError(f"refinement_kind is {name!r}, but must be one of {', '.join(kinds)}.")
    return kinds[name]


def _arrays(taste: PoseTaste) -> dict[str, np.ndarray]:
    style = {f"style_{key}": value for key, value in taste.style._asdict().items()}
    return {"weights": taste.weights, "miss": taste.miss, "spreads": taste.spreads, **style}


def _about(codes: torch.Tensor | None) -> dict[str, Any]:
    """Returns the description in a weight file; empty where it is missing or unreadable."""
    if codes is None:
        return {}
    try:
        found = json.loads(bytes(int(code) for code in codes.tolist()))
    except (TypeError, ValueError, OverflowError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _kinds(about: dict[str, Any]) -> list[str]:
    given = about.get("kinds")
    names = [name for name in given if isinstance(name, str) and name] if isinstance(given, list) else []
    if not names or names != given or len(set(names)) < len(names):
        raise WeightsError("The weight file does not name the kinds of object that it is for, each once.")
    return names


def _origin(about: dict[str, Any]) -> Origin:
    names = {f.name for f in fields(Origin)}
    if about.keys() - {"version", "kinds"} != names or about["view"] not in (None, *VIEWS):
        raise WeightsError("The weight file does not say of what rig it is, or names a view that is not known.")
    if not isinstance(about["lifts"], str):
        raise WeightsError("The weight file does not say with which network of lifts it was learned.")
    return Origin(**{name: about[name] for name in names})


def _text(value: object) -> str:
    """Returns a value as a message shows it; of a hash its beginning."""
    text = str(value)
    return f"{text[:12]}..." if isinstance(value, str) and len(value) == 64 else text
