"""Weight files of the refinement: a torch state dict of preferences by kind of object, and the rig of their training.

A refinement fits one first network, view, crop, table and hand; a file is refused where they differ. Values that a file
does not contain are not compared.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import torch

from grasping.network import weights
from grasping.network.depth_image import CAMERA, TABLE, VIEWS
from grasping.network.weights import WeightsError
from grasping.refinement import lifts, taste
from grasping.refinement.candidates import LIFTS
from grasping.refinement.lifts import LiftModel
from grasping.refinement.preference import Preference
from grasping.refinement.taste import HandStyle, Taste

VERSION = 4
ANY_KIND = "any"  # name of the kind of these files, and of what was learned from all kinds together
TERMS = lifts.terms(np.zeros((1, len(LIFTS))), np.zeros(1), np.zeros((1, 2)), np.zeros(1)).shape[1]
ABOUT = "about"  # entry of a weight file beside the weights: the characters' codes of a JSON text
TABLE_KEYS = ("extent", "distance")  # of the settings of the view from above, those that make its image another one


@dataclass(frozen=True)
class Origin:
    """The rig of episodes, as far as a refinement depends on it; None where that is unknown or of no matter."""

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


def content(kinds: Mapping[str, Preference], origin: Origin) -> dict[str, torch.Tensor]:
    """Returns what a weight file holds; `kinds`: what was learned of each kind of object, by its name."""
    codes = json.dumps({"version": VERSION, "kinds": list(kinds), **asdict(origin)}, sort_keys=True).encode()
    arrays = {
        _prefix(i) + key: torch.as_tensor(np.array(value, np.float32))
        for i, known in enumerate(kinds.values())
        for key, value in _arrays(known).items()
    }
    return {**arrays, ABOUT: torch.tensor(list(codes))}


def load(data: bytes, sha256: str | None = None) -> tuple[dict[str, Preference], Origin]:
    """Returns a weight file's preferences by kind of object, at least one, and the rig of its training; runs no code of
    the file. Raises WeightsError for another `sha256` (if given, hexadecimal), no torch file, another version, or
    something else in it.
    """
    one_kind = 3  # the version of before, whose files hold one preference and do not say of which kind
    weights.checked_sha256(data, sha256)
    state = weights.torch_state(data)
    about = about_of(state.pop(ABOUT, None))
    if about.get("version") not in (one_kind, VERSION):
        raise WeightsError(
            f"The weight file holds no refinement of version {VERSION}: train it again on the same episodes with "
            "train_refinement.py."
        )
    prefixes = {ANY_KIND: ""}
    if about["version"] == VERSION:
        prefixes = {name: _prefix(i) for i, name in enumerate(kinds_of(about))}
    wanted = {}
    for prefix in prefixes.values():
        with_lifts = f"{prefix}lift_weights" in state
        model = LiftModel(np.zeros(TERMS), np.ones(TERMS), np.zeros(TERMS + 1)) if with_lifts else None
        wanted.update({prefix + key: value for key, value in _arrays(Preference(taste.nobody(), model)).items()})
    if state.keys() != wanted.keys():
        names = ", ".join(sorted(wanted.keys() ^ state.keys()))
        raise WeightsError(f"The weight file lacks or adds to a refinement: {names}.")
    found = {key: value.double().numpy() for key, value in state.items()}
    for key, value in wanted.items():
        if found[key].shape != np.shape(value):
            raise WeightsError(f"The array {key} has the shape {found[key].shape} instead of {np.shape(value)}.")
        if not np.isfinite(found[key]).all():
            raise WeightsError("The weight file holds values that are not finite.")
        if key.endswith(("spreads", "lift_scale")) and (found[key] <= 0.0).any():
            raise WeightsError("The weight file holds standard deviations that are not positive.")
    kinds = {
        name: _preference({key[len(prefix) :]: value for key, value in found.items() if key.startswith(prefix)})
        for name, prefix in prefixes.items()
    }
    return kinds, origin_of(about)


def of_kind(kinds: Mapping[str, Preference], name: str) -> Preference:
    """Returns the preference of the kind `name`; an empty `name` means the only kind.

    Raises:
        WeightsError: the kind is unknown, or `name` is empty and there are several.
    """
    if not name and len(kinds) == 1:
        return next(iter(kinds.values()))
    if name not in kinds:
        raise WeightsError(f"refinement_kind is {name!r}, but must be one of {', '.join(kinds)}.")
    return kinds[name]


def _prefix(number: int) -> str:
    return f"{number}/"


def _arrays(known: Preference) -> dict[str, Any]:
    of, hand = known.taste, known.taste.hand
    arrays = {
        "weights": of.weights,
        "miss": of.miss,
        "line": hand.line,
        "tilt_x": hand.tilt_x,
        "tilt_y": hand.tilt_y,
        "opening": hand.opening,
        "spreads": np.array([of.spread, of.angle_spread, hand.tilt_spread, hand.opening_spread]),
    }
    if known.lifts is not None:
        arrays.update({f"lift_{key}": value for key, value in known.lifts._asdict().items()})
    return arrays


def _preference(found: Mapping[str, np.ndarray]) -> Preference:
    spread, angle_spread, tilt_spread, opening_spread = found["spreads"].tolist()
    hand = HandStyle(found["line"], found["tilt_x"], found["tilt_y"], found["opening"], tilt_spread, opening_spread)
    model = None
    if "lift_weights" in found:
        model = LiftModel(*(found[f"lift_{key}"] for key in LiftModel._fields))
    return Preference(Taste(found["weights"], found["miss"], spread, angle_spread, hand), model)


def about_of(codes: torch.Tensor | None) -> dict[str, Any]:
    """Returns the description in a weight file; empty where it is missing or unreadable."""
    if codes is None:
        return {}
    try:
        found = json.loads(bytes(int(code) for code in codes.tolist()))
    except (TypeError, ValueError, OverflowError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def kinds_of(about: dict[str, Any]) -> list[str]:
    given = about.get("kinds")
    names = [name for name in given if isinstance(name, str) and name] if isinstance(given, list) else []
    if not names or names != given or len(set(names)) < len(names):
        raise WeightsError("The weight file does not name the kinds of object that it is for, each once.")
    return names


def origin_of(about: dict[str, Any]) -> Origin:
    names = {f.name for f in fields(Origin)}
    if about.keys() - {"version", "kinds"} != names or about["view"] not in (None, *VIEWS):
        raise WeightsError("The weight file does not say of what rig it is, or names a view that is not known.")
    return Origin(**{name: about[name] for name in names})


def _text(value: object) -> str:
    """Returns a value as a message shows it; of a hash its beginning."""
    text = str(value)
    return f"{text[:12]}..." if isinstance(value, str) and len(value) == 64 else text
