"""Trains the refinement network on episodes of an operator's grasps; may be stopped and resumed at any time.

The folder of the run holds checkpoint.pt (to resume, with the same episodes and settings), weights.pt (the best so
far), taste.pt (the same without the constant offset and the lean about the view's axes, which belong to this operator's
hand and site alone), settings.json, curves.csv and curves.png. One in five episodes, chosen by its file's name, is held
out to decide when training stops.
"""

from __future__ import annotations

import argparse
import hashlib
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import Episode
from grasping.lab.programs import runs
from grasping.lab.training import refinement_examples
from grasping.lab.training.refinement_trainer import RefinementTraining, refinement_trainer
from grasping.network.depth_image import VIEWS
from grasping.network.refinement import RefinementNetwork
from grasping.network.refinement_file import Origin, content, taste

HELD_OUT = 5  # one in this many episodes is held out of training and decides when it stops
LOSSES = ("training", "validation", "place", "depth", "turn", "opening", "tilt")
CURVES = runs.Curves(
    ("step", *LOSSES, "miss"),
    losses=LOSSES,
    scale="linear",
    metric="miss",
    label="median miss on held-out episodes [px]",
)


class Named(NamedTuple):
    """An episode, the name of its file, without the ending, and the SHA-256 of its content, hexadecimal."""

    name: str
    episode: Episode
    sha256: str


def read_episodes(folder: Path, only: Iterable[str] = (), without: Iterable[str] = ()) -> list[Named]:
    """Returns the episodes in and below a folder, ordered by name; `only` (if any) and `without` name objects.

    Raises RigError if there is no such episode, or a file is not one.
    """
    found = []
    for path in tqdm(sorted(folder.rglob("*" + store.SUFFIX)), unit="episode", desc="read"):
        data = path.read_bytes()
        try:
            episode = store.decode(data)
        except RigError as error:
            raise RigError(f"{path}: {error}") from None
        things = {thing.strip() for thing in episode.metadata.object.split(",")}
        if (not only or things & set(only)) and not things & set(without):
            found.append(Named(path.stem, episode, hashlib.sha256(data).hexdigest()))
    if not found:
        raise RigError(f"{folder} holds no episode of these things: collect some, or run make_episodes.py.")
    return found


def origin_of(named: list[Named], mixed: bool = False) -> Origin:
    """Returns the rig of all episodes; if `mixed`, what differs among several rigs is unknown.

    Raises RigError for several views or an unknown one, and for several rigs if they must not be mixed.
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


def is_held_out(name: str) -> bool:
    """Returns whether an episode is held out of training; depends on its name alone."""
    return zlib.crc32(name.encode()) % HELD_OUT == 0


def prepared(named: list[Named]) -> list[refinement_examples.Example]:
    """Returns the examples of all frames that have one."""
    found = [refinement_examples.example(f, n.episode.held) for n in named for f in n.episode.frames()]
    return [e for e in found if e is not None]


def parse() -> argparse.Namespace:
    default = RefinementTraining()
    parser = argparse.ArgumentParser(description=__doc__)
    runs.add_options(parser, "episodes", default, every=50)
    parser.add_argument("--episodes", type=int, default=10**6, help="most episodes to train on")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="train on none of these")
    parser.add_argument("--mixed", action="store_true", help="train on episodes of several rigs all the same")
    arguments = parser.parse_args()
    for name in ("steps", "count", "hidden", "patience", "episodes", "every", "threads"):
        if getattr(arguments, name) < 1:
            parser.error(f"--{name.replace('_', '-')} is {getattr(arguments, name)}, but must be at least 1.")
    torch.set_num_threads(arguments.threads)
    try:
        named = read_episodes(arguments.data, without=arguments.without)
        arguments.origin = origin_of(named, arguments.mixed)
        arguments.device = runs.device(arguments.device)
        arguments.training = [n for n in named if not is_held_out(n.name)][: arguments.episodes]
        arguments.validation = [n for n in named if is_held_out(n.name)]
        for part in (arguments.training, arguments.validation):
            if not any(n.episode.held for n in part):
                raise RigError(f"Of {len(named)} episodes, too few show a grasp that held to train on some of them.")
        arguments.settings = RefinementTraining(**{name: getattr(arguments, name) for name in asdict(default)})
        arguments.identity = runs.identity(
            {**asdict(arguments.settings), **asdict(arguments.origin)},
            *([n.sha256 for n in part] for part in (arguments.training, arguments.validation)),
        )
        arguments.saved = runs.opened(arguments.run, arguments.identity, arguments.anew)
    except (RigError, OSError) as error:
        parser.error(str(error))
    return arguments


def main() -> None:
    arguments = parse()
    settings, origin = arguments.settings, arguments.origin
    offset = refinement_examples.constant_offset(
        [f for n in arguments.training if n.episode.held for f in n.episode.frames()]
    )
    examples, validation = prepared(arguments.training), prepared(arguments.validation)
    about = {**asdict(settings), **asdict(origin), "episodes": len(arguments.training), "frames": len(examples)}
    about.update(offset=offset._asdict(), identity=arguments.identity)
    trainer = refinement_trainer(settings, offset, arguments.device)

    def files(mean: RefinementNetwork) -> dict[str, object]:
        return {"weights.pt": content(mean, origin), "taste.pt": taste(mean, origin)}

    data = examples, validation
    runs.train(arguments.run, about, arguments.saved, trainer, data, arguments.every, files, CURVES, settings.patience)
