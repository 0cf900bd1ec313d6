"""Trains the refinement network on episodes of an operator's grasps; may be stopped and resumed at any time.

The folder of the run holds checkpoint.pt (to resume, with the same episodes and settings), weights.pt (the best so
far), taste.pt (the same without the constant offset and the lean about the view's axes, which belong to this operator's
hand and site alone), settings.json, curves.csv and curves.png. One in five episodes, chosen by its file's name, is held
out to decide when training stops.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict

import torch

from common.errors import RigError
from grasping.lab.programs import episode_reading, runs
from grasping.lab.training import refinement_examples
from grasping.lab.training.refinement_trainer import RefinementTrainer, RefinementTraining
from grasping.network import refinement_file

LOSSES = ("training", "validation", "place", "depth", "turn", "opening", "tilt")
CURVES = runs.Curves(
    ("step", *LOSSES, "miss"),
    losses=LOSSES,
    scale="linear",
    metric="miss",
    label="median miss on held-out episodes [px]",
)


def prepared(named: list[episode_reading.Named]) -> list[refinement_examples.Example]:
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
        named = episode_reading.read(arguments.data, without=arguments.without)
        arguments.origin = episode_reading.origin_of(named, arguments.mixed)
        arguments.device = runs.device(arguments.device)
        arguments.training = [n for n in named if not episode_reading.is_held_out(n.name)][: arguments.episodes]
        arguments.validation = [n for n in named if episode_reading.is_held_out(n.name)]
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
    about = {
        **asdict(settings),
        **asdict(origin),
        "episodes": len(arguments.training),
        "frames": len(examples),
        "offset": offset._asdict(),
        "identity": arguments.identity,
    }
    runs.train(
        arguments.run,
        about,
        arguments.saved,
        RefinementTrainer(settings, offset, arguments.device),
        (examples, validation),
        arguments.every,
        lambda mean: {
            "weights.pt": refinement_file.content(mean, origin),
            "taste.pt": refinement_file.taste(mean, origin),
        },
        CURVES,
        settings.patience,
    )
