"""Makes episodes of a simulated operator's grasps, in the file format of `collect.launch`; resumable."""

from __future__ import annotations

import argparse
from functools import lru_cache
from pathlib import Path

import cv2
import mujoco
import torch

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.programs.make_dataset import ignore_warning, make_all
from grasping.lab.synthetic import simulated_operator
from grasping.lab.synthetic.simulated_operator import SimulatedOperator
from grasping.network import weights
from grasping.network.networks import MapNetwork, frozen


@lru_cache(maxsize=1)
def network(path: Path) -> tuple[MapNetwork, str]:
    """Returns the network of a weight file, and the file's hash."""
    loaded = weights.load(path.read_bytes())
    return frozen(loaded.network), loaded.sha256


def make(task: tuple[Path, Path, str, int, int]) -> None:
    """Writes one episode unless it is there."""
    folder, file, split, number, frames = task
    path = folder / (simulated_operator.file_name(split, number) + store.SUFFIX)
    if path.exists():
        return
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    ggcnn, sha256 = network(file)
    made = simulated_operator.episode(split, number, ggcnn, sha256, SimulatedOperator(), frames)
    if made is not None:
        part = path.with_suffix(".part")
        part.write_bytes(store.encode(made))
        part.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the episodes go")
    parser.add_argument("weights", type=Path, help="weight file of GGCNN")
    parser.add_argument("--split", choices=("person", "person_test"), default="person", help="known or held-out things")
    parser.add_argument("--episodes", type=int, default=400, help="how many scenes; where nothing holds, none is made")
    parser.add_argument("--frames", type=int, default=2, help="images an episode")
    parser.add_argument("--processes", type=int, default=1, help="how many at a time")
    arguments = parser.parse_args()
    if arguments.frames < 1:
        parser.error(f"--frames is {arguments.frames}, but must be at least 1.")
    try:
        network(arguments.weights)
    except (OSError, RigError) as error:
        parser.error(str(error))
    tasks = [
        (arguments.folder, arguments.weights, arguments.split, number, arguments.frames)
        for number in range(arguments.episodes)
    ]
    make_all(parser, arguments.folder, make, tasks, arguments.processes, "episode")
