"""Makes episodes of simulated operators' grasps, in the file format of `collect.launch`; resumable.

Each operator gets a folder.
"""

from __future__ import annotations

import argparse
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import mujoco
import torch

from common.command_line import whole
from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.programs.make_dataset import ignore_warning, make_all
from grasping.lab.synthetic import samples, simulated_operator
from grasping.lab.synthetic.simulated_operator import OPERATORS
from grasping.network import weights
from grasping.network.networks import MapNetwork, frozen

SPLITS = tuple(name for name in samples.SPLITS if name.startswith(("person", "kind_")))
ALL = "all"


class EpisodeTask(NamedTuple):
    """A scene whose episodes are to be made."""

    folder: Path
    weights: Path  # of GGCNN
    split: str
    number: int  # of the scene
    frames: int
    operators: tuple[str, ...]


@lru_cache(maxsize=1)
def network(path: Path) -> tuple[MapNetwork, str]:
    """Returns the network of a weight file, and the file's hash."""
    loaded = weights.load(path.read_bytes())
    return frozen(loaded.network), loaded.sha256


def make(task: EpisodeTask) -> None:
    """Writes the episodes of one scene unless they are there."""
    name = simulated_operator.file_name(task.split, task.number) + store.SUFFIX
    missing = [who for who in task.operators if not (task.folder / who / name).exists()]
    if not missing:
        return
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    made = simulated_operator.episodes(task.split, task.number, *network(task.weights), missing, task.frames)
    for who, episode in made:
        path = task.folder / who / name
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(store.encode(episode))
        part.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the episodes go")
    parser.add_argument("weights", type=Path, help="weight file of GGCNN")
    parser.add_argument("--split", choices=SPLITS, default="person", help="known or held-out things, or one kind")
    parser.add_argument("--operator", choices=(*OPERATORS, ALL), default="high", help="who grasps")
    parser.add_argument("--first", type=whole(0, 10**9), default=0, help="number of the first scene")
    parser.add_argument(
        "--episodes", type=whole(1, 10**9), default=400, help="how many scenes; where nothing holds, none is made"
    )
    parser.add_argument("--frames", type=whole(1, 10**6), default=1, help="images an episode")
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many at a time")
    arguments = parser.parse_args()
    try:
        network(arguments.weights)
    except (OSError, RigError) as error:
        parser.error(str(error))
    who = tuple(OPERATORS) if arguments.operator == ALL else (arguments.operator,)
    numbers = range(arguments.first, arguments.first + arguments.episodes)
    about = (arguments.frames, who)
    tasks = [EpisodeTask(arguments.folder, arguments.weights, arguments.split, n, *about) for n in numbers]
    make_all(parser, arguments.folder, make, tasks, arguments.processes, "scene")
