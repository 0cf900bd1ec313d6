"""Learns from episodes of an operator's grasps which of those that a network of lifts offers the operator prefers.

The folder of the run gets weights.pt, for `refinement_weights` in ggcnn.yaml, and settings.json, which says what was
learned. Each kind of object is learned from its own episodes; the file holds all kinds. It takes seconds.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import Episode
from grasping.lab.training import lift_examples
from grasping.network.depth_image import VIEWS
from grasping.network.weights import checked_sha256
from grasping.poses.candidates import TASTES
from grasping.poses.lift_network import LiftNetwork, loaded
from grasping.poses.taste import PoseTaste, learned, options
from grasping.poses.taste_file import ANY_KIND, Origin, TasteFile, content


class Named(NamedTuple):
    """An episode and the path of its file, without the ending, below the folder that was read."""

    name: str
    episode: Episode

    @property
    def objects(self) -> set[str]:
        return {thing.strip() for thing in self.episode.metadata.object.split(",") if thing.strip()}


def read_episodes(folder: Path, only: Iterable[str] = (), without: Iterable[str] = ()) -> list[Named]:
    """Returns the episodes in and below a folder, ordered by name; `only` (if any) and `without` name objects. Raises
    RigError if there is no such episode, or a file is not one.
    """
    found = []
    for path in tqdm(sorted(folder.rglob("*" + store.SUFFIX)), unit="episode", desc="read"):
        try:
            named = Named(str(path.relative_to(folder).with_suffix("")), store.decode(path.read_bytes()))
        except RigError as error:
            raise RigError(f"{path}: {error}") from None
        if (not only or named.objects & set(only)) and not named.objects & set(without):
            found.append(named)
    if not found:
        raise RigError(f"{folder} holds no episode of these things: collect some, or run make_episodes.py.")
    return found


def by_kind(named: Sequence[Named], only: Iterable[str] = ()) -> dict[str, list[Named]]:
    """Returns the episodes of each kind of object, ordered by its name; `only` (if any) names the kinds."""
    found: dict[str, list[Named]] = {name: [] for name in sorted(set(only) or {o for n in named for o in n.objects})}
    for one in named:
        for name in one.objects & found.keys():
            found[name].append(one)
    return found


def origin_of(named: list[Named], mixed: bool = False) -> Origin:
    """Returns the rig of all episodes; if `mixed`, what differs among several rigs is unknown. Raises RigError for
    several views or an unknown one, and for several rigs if they must not be mixed.
    """
    views = sorted({n.episode.view for n in named})
    if len(views) > 1 or views[0] not in VIEWS:
        raise RigError(
            f"The episodes are of the views {', '.join(views)}, whose grasps have other axes: train on those of one, "
            f"{' or '.join(VIEWS)}."
        )
    first, *others = (asdict(Origin.of(n.episode.metadata.configuration)) for n in named)
    pairs = zip(named[1:], others)
    differing = {name: n.name for n, other in pairs for name in first if first[name] != other[name]}
    if differing and not mixed:
        name, other = next(iter(differing.items()))
        raise RigError(
            f"The episodes are of several rigs, {named[0].name} and {other} differ in {name}: train on those of one, "
            "or with --mixed."
        )
    return Origin(**{**first, **dict.fromkeys(differing)})


def learned_by_kind(kinds: Mapping[str, Iterable[Named]], network: LiftNetwork) -> dict[str, tuple[PoseTaste, int]]:
    """Returns of each kind the taste that its episodes teach, and how many do. Raises RigError if none does."""
    found = {}
    for name, named in kinds.items():
        shown = []
        for one in named:
            of = lift_examples.image_maps(one.episode.frame(len(one.episode) - 1))
            if of is not None:
                grasp = lift_examples.shown(one.episode, options(network, of, network.gripper.opening))
                shown += [] if grasp is None else [grasp]
        if not shown:
            raise RigError(f"In none of the episodes of {name} the camera sees the operator's grasp.")
        found[name] = learned(shown), len(shown)
    return found


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the operator's episodes")
    parser.add_argument("run", type=Path, help="where the results go")
    lifts_help = "weights of the network of lifts that the node will use"
    parser.add_argument("--lifts", type=Path, required=True, help=lifts_help)
    parser.add_argument("--only", action="append", default=[], metavar="OBJECT", help="learn these kinds alone")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="learn from none of these")
    pooled_help = "learn from all kinds together, for a node that is not told the kind"
    parser.add_argument("--pooled", action="store_true", help=pooled_help)
    parser.add_argument("--mixed", action="store_true", help="learn from episodes of several rigs all the same")
    arguments = parser.parse_args()
    try:
        arguments.named = read_episodes(arguments.data, arguments.only, arguments.without)
        data = arguments.lifts.read_bytes()
        network = loaded(data)
        origin = origin_of(arguments.named, arguments.mixed)
        if origin.network is not None and origin.network != network.ggcnn:
            raise RigError(
                f"The network of lifts in {arguments.lifts} was made for the GG-CNN {network.ggcnn[:12]}, but the "
                f"episodes are of {origin.network[:12]}."
            )
        arguments.origin = replace(origin, lifts=checked_sha256(data, None))
        kinds = {ANY_KIND: arguments.named} if arguments.pooled else by_kind(arguments.named, arguments.only)
        if not kinds:
            raise RigError(f"The episodes in {arguments.data} name no kind of object: learn with --pooled.")
        missing = [name for name, of in kinds.items() if not of]
        if missing:
            raise RigError(f"{arguments.data} holds no episode of {missing[0]}: collect some, or leave it out.")
        arguments.run.mkdir(parents=True, exist_ok=True)
        arguments.learned = learned_by_kind(kinds, network)
    except (RigError, OSError) as error:
        parser.error(str(error))
    return arguments


def summary(known: PoseTaste, count: int) -> dict[str, object]:
    """Returns what was learned of a kind, for people."""
    style, (place, line, tilt, opening) = known.style, known.spreads.tolist()
    return {
        "episodes": count,
        "liked": {name: round(float(w), 2) for name, w in zip((*TASTES, "lift"), known.weights)},
        "miss_mm": (1000.0 * known.miss).round(1).tolist(),
        "line_rad": style.line.round(3).tolist(),
        "tilt_x_rad": style.tilt_x.round(3).tolist(),
        "tilt_y_rad": style.tilt_y.round(3).tolist(),
        "deeper_mm": (1000.0 * style.deep).round(1).tolist(),
        "wider_mm": (1000.0 * style.wider).round(1).tolist(),
        "spread_mm": round(1000.0 * place, 1),
        "spread_line_rad": round(line, 3),
        "spread_tilt_rad": round(tilt, 3),
        "spread_opening_mm": round(1000.0 * opening, 1),
    }


def main() -> None:
    arguments = parse()
    kinds = {name: known for name, (known, _) in arguments.learned.items()}
    torch.save(content(TasteFile(kinds, arguments.origin)), arguments.run / "weights.pt")
    said = {name: summary(*of) for name, of in arguments.learned.items()}
    text = json.dumps({"kinds": said, **asdict(arguments.origin)}, indent=2)
    (arguments.run / "settings.json").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
