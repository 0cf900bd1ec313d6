"""Trains the refinement network on episodes of an operator's grasps; may be stopped and resumed at any time.

The folder of the run holds checkpoint.pt (to resume with the same episodes and settings), weights.pt (the best so far),
taste.pt (the same without the constant offset and the lean about the view's axes, which are of this operator's hand and
place alone), settings.json, curves.csv and curves.png. One in five episodes, by its file's name, is kept to say when
training is over.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.programs import episode_reading, runs
from grasping.lab.training import refinement_examples
from grasping.lab.training.refinement_trainer import RefinementTrainer, RefinementTraining
from grasping.network import refinement_file

COLUMNS = ("step", "training", "validation", "place", "depth", "turn", "opening", "tilt", "miss")


def plot(rows: list[dict], path: Path) -> None:
    """Draws the curves."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [r["step"] for r in rows]
    for name in COLUMNS[1:-1]:
        left.plot(steps, [r[name] for r in rows], label=name)
    left.set(xlabel="step", ylabel="loss")
    left.legend()
    right.plot(steps, [r["miss"] for r in rows])
    right.set(xlabel="step", ylabel="median miss on held-out episodes [px]", ylim=(0, None))
    figure.savefig(path, dpi=110)


def prepared(named: list[episode_reading.Named]) -> list[refinement_examples.Example]:
    """Returns the examples of all frames that have one."""
    found = [refinement_examples.example(f, n.episode.held) for n in named for f in n.episode.frames()]
    return [e for e in found if e is not None]


def parse() -> argparse.Namespace:
    default = RefinementTraining()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the episodes")
    parser.add_argument("run", type=Path, help="folder of the run; the same training in it is gone on with")
    for name, value in asdict(default).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=type(value), default=value, help=f"default: {value}")
    parser.add_argument("--episodes", type=int, default=10**6, help="most episodes to train on")
    parser.add_argument("--without", action="append", default=[], metavar="OBJECT", help="train on none of these")
    parser.add_argument("--mixed", action="store_true", help="train on episodes of several rigs all the same")
    runs.add_options(parser)
    parser.add_argument("--every", type=int, default=50, help="steps between validations and checkpoints")
    parser.add_argument("--threads", type=int, default=1, help="of the arithmetic")
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
    settings, identity, saved = arguments.settings, arguments.identity, arguments.saved
    offset = refinement_examples.constant_offset(
        [f for n in arguments.training if n.episode.held for f in n.episode.frames()]
    )
    examples, validation = prepared(arguments.training), prepared(arguments.validation)
    trainer, rows, recent = RefinementTrainer(settings, offset, arguments.device), [], []
    if saved is not None:
        trainer.resume(saved["trainer"])
        rows = saved["rows"]
    about = {
        **asdict(settings),
        **asdict(arguments.origin),
        "episodes": len(arguments.training),
        "frames": len(examples),
        "offset": offset._asdict(),
        "identity": identity,
    }
    (arguments.run / "settings.json").write_text(json.dumps(about, indent=2) + "\n")
    bar = tqdm(total=settings.steps, initial=trainer.step, unit="step", mininterval=10.0)
    while trainer.step < settings.steps and not is_over(rows, settings.patience):
        recent.append(trainer.train(examples))
        bar.update()
        if trainer.step % arguments.every and trainer.step < settings.steps:
            continue
        found = trainer.validate(validation)
        if all(found["validation"] < r["validation"] for r in rows):
            runs.save(refinement_file.content(trainer.mean, arguments.origin), arguments.run / "weights.pt")
            runs.save(refinement_file.taste(trainer.mean, arguments.origin), arguments.run / "taste.pt")
        rows.append({"step": trainer.step, "training": float(np.mean(recent)), **found})
        recent = []
        bar.set_postfix_str(f"loss {found['validation']:.3f}, miss {found['miss']:.1f} px")
        runs.save({"identity": identity, "trainer": trainer.state(), "rows": rows}, arguments.run / runs.CHECKPOINT)
        with (arguments.run / "curves.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        plot(rows, arguments.run / "curves.png")


def is_over(rows: list[dict], patience: int) -> bool:
    """Returns whether the last `patience` validations were no better than the best one before them."""
    found = [r["validation"] for r in rows]
    return len(found) > patience and min(found[-patience:]) >= min(found[:-patience])
