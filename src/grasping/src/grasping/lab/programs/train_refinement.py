"""Learns from episodes of an operator's grasps which ones the operator prefers, and what is lifted; takes seconds.

The folder of the run gets weights.pt, for `refinement_weights` in ggcnn.yaml, and settings.json, which says what was
learned. Each kind of object is learned from its own episodes; the file holds all kinds. With --lifts it is a taste of
full poses, among what that network says is lifted; the node does not take such a file yet. Without, what is lifted is
learned from the outcomes of all grasps that were at a candidate, of these episodes and of those in --outcomes; if they
are too few, nothing is known of lifts and nothing constrains the operator's taste.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import Episode
from grasping.lab.synthetic.samples import GRIPPER
from grasping.lab.training import lift_examples
from grasping.lab.training import refinement_examples as examples
from grasping.network.depth_image import VIEWS
from grasping.network.weights import checked_sha256
from grasping.poses import taste as poses_taste
from grasping.poses import taste_file
from grasping.poses.lift_network import LiftNetwork, loaded
from grasping.poses.taste import options
from grasping.poses.taste_file import TasteFile
from grasping.refinement import taste
from grasping.refinement.candidates import TASTES
from grasping.refinement.preference import Preference
from grasping.refinement.refinement_file import ANY_KIND, Origin, content
from grasping.refinement.taste import Choice


class Named(NamedTuple):
    """An episode and the path of its file, without the ending, below the folder that was read."""

    name: str
    episode: Episode

    @property
    def objects(self) -> set[str]:
        return {thing.strip() for thing in self.episode.metadata.object.split(",") if thing.strip()}


class Lesson(NamedTuple):
    """What an episode teaches."""

    choice: Choice  # in its last frame
    outcome: examples.Outcome | None  # of that grasp


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


def lesson(episode: Episode) -> Lesson | None:
    """Returns what an episode teaches; None where the camera saw nothing or the grasp was outside its view."""
    frame = episode.frame(len(episode) - 1)
    of = examples.seen(frame)
    choice = None if of is None else examples.choice(frame, of)
    return None if choice is None else Lesson(choice, examples.outcome(choice, episode.held))


def lessons(named: Iterable[Named]) -> list[Lesson]:
    found = (lesson(n.episode) for n in named)
    return [one for one in found if one is not None]


def tastes_by_kind(kinds: Mapping[str, Iterable[Named]], network: LiftNetwork) -> dict[str, poses_taste.PoseTaste]:
    """Returns of each kind the taste that its episodes teach. Raises RigError if there is no such episode."""
    found = {}
    for name, named in kinds.items():
        shown = []
        for one in named:
            of = lift_examples.image_maps(one.episode.frame(len(one.episode) - 1))
            grasp = None if of is None else examples.shown(one.episode, options(network, of, GRIPPER.opening))
            shown += [] if grasp is None else [grasp]
        if not shown:
            raise RigError(f"In none of the episodes of {name} the camera sees the operator's grasp.")
        found[name] = poses_taste.learned(shown)
    return found


def preference(of: Iterable[Lesson], outcomes: Iterable[Lesson] = ()) -> Preference:
    """Returns the operator's preference; `outcomes`: of others."""
    own = list(of)
    rows = [one.outcome for one in (*own, *outcomes) if one.outcome is not None]
    return Preference(taste.learned([one.choice for one in own]), examples.lift_model(rows))


def learned_by_kind(
    kinds: Mapping[str, Iterable[Named]], outcomes: Iterable[Named] = ()
) -> dict[str, tuple[Preference, int]]:
    """Returns of each kind what its episodes teach, and how many do; `outcomes`: of others. Raises RigError if there is
    no such episode.
    """
    others, found = lessons(outcomes), {}
    for name, named in kinds.items():
        own = lessons(named)
        if not own:
            raise RigError(f"In none of the episodes of {name} the camera sees the operator's grasp.")
        found[name] = preference(own, others), len(own)
    return found


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the operator's episodes")
    parser.add_argument("run", type=Path, help="where the results go")
    parser.add_argument("--outcomes", type=Path, help="folder of episodes by anybody, for what is lifted")
    parser.add_argument("--lifts", type=Path, help="weights of the network of lifts: learn a taste of full poses")
    parser.add_argument("--only", action="append", default=[], metavar="OBJECT", help="learn these kinds alone")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="learn from none of these")
    pooled_help = "learn from all kinds together, for a node that is not told the kind"
    parser.add_argument("--pooled", action="store_true", help=pooled_help)
    parser.add_argument("--mixed", action="store_true", help="learn from episodes of several rigs all the same")
    arguments = parser.parse_args()
    try:
        arguments.named = read_episodes(arguments.data, arguments.only, arguments.without)
        arguments.others = [] if arguments.outcomes is None else read_episodes(arguments.outcomes)
        arguments.origin = origin_of([*arguments.named, *arguments.others], arguments.mixed)
        kinds = {ANY_KIND: arguments.named} if arguments.pooled else by_kind(arguments.named, arguments.only)
        if not kinds:
            raise RigError(f"The episodes in {arguments.data} name no kind of object: learn with --pooled.")
        missing = [name for name, of in kinds.items() if not of]
        if missing:
            raise RigError(f"{arguments.data} holds no episode of {missing[0]}: collect some, or leave it out.")
        arguments.run.mkdir(parents=True, exist_ok=True)
        if arguments.lifts is not None:
            data = arguments.lifts.read_bytes()
            tastes = tastes_by_kind(kinds, loaded(data))
            arguments.tastes = TasteFile(tastes, arguments.origin, checked_sha256(data, None))
        else:
            arguments.learned = learned_by_kind(kinds, arguments.others)
    except (RigError, OSError) as error:
        parser.error(str(error))
    return arguments


def summary(known: Preference, count: int) -> dict[str, object]:
    """Returns what was learned of a kind, for people."""
    of, hand = known.taste, known.taste.hand
    return {
        "episodes": count,
        "liked": {name: round(float(w), 2) for name, w in zip(TASTES, of.weights)},
        "miss_mm": (1000.0 * of.miss).round(1).tolist(),
        "spread_mm": round(1000.0 * of.spread, 1),
        "line_rad": hand.line.round(3).tolist(),
        "tilt_x_rad": hand.tilt_x.round(3).tolist(),
        "tilt_y_rad": hand.tilt_y.round(3).tolist(),
        "wider_mm": (1000.0 * hand.opening).round(1).tolist(),
        "constrained": known.lifts is not None,
    }


def main() -> None:
    arguments = parse()
    if arguments.lifts is not None:
        torch.save(taste_file.content(arguments.tastes), arguments.run / "weights.pt")
        return
    kinds = {name: known for name, (known, _) in arguments.learned.items()}
    torch.save(content(kinds, arguments.origin), arguments.run / "weights.pt")
    said = {name: summary(*of) for name, of in arguments.learned.items()}
    text = json.dumps({"kinds": said, **asdict(arguments.origin)}, indent=2)
    (arguments.run / "settings.json").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
