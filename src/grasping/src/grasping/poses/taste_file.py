"""Files of tastes: a torch state dict of one taste for each kind of object, and the rig and the network of lifts that
they were learned with; a file is refused where these differ."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
import torch

from grasping.network import weights
from grasping.network.weights import WeightsError
from grasping.poses.taste import PoseTaste, Style, nobody
from grasping.refinement.refinement_file import ABOUT, Origin, about_of, kinds_of, origin_of

VERSION = 5  # of before: the files of another way to choose


class TasteFile(NamedTuple):
    """What a file holds."""

    kinds: Mapping[str, PoseTaste]  # by the kind of object, at least one
    origin: Origin
    lifts: str  # SHA-256 of the weight file of the network of lifts, hexadecimal


def content(of: TasteFile) -> dict[str, torch.Tensor]:
    about = {"version": VERSION, "kinds": list(of.kinds), "lifts": of.lifts, **asdict(of.origin)}
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
    about = about_of(state.pop(ABOUT, None))
    if about.get("version") != VERSION or not isinstance(about.get("lifts"), str):
        raise WeightsError(
            f"The weight file holds no tastes of version {VERSION}: train it again on the same episodes with "
            "train_refinement.py."
        )
    names, lifts = kinds_of(about), about.pop("lifts")
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
    return TasteFile(kinds, origin_of(about), lifts)


def _arrays(taste: PoseTaste) -> dict[str, np.ndarray]:
    style = {f"style_{key}": value for key, value in taste.style._asdict().items()}
    return {"weights": taste.weights, "miss": taste.miss, "spreads": taste.spreads, **style}
