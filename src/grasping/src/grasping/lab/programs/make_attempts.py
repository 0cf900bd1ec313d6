"""Makes the data of the network of lifts: shards of depth images with grasps in six degrees of freedom, each tried in
the physics; resumable."""

from __future__ import annotations

import argparse
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
import torch

from common.command_line import whole
from common.errors import RigError
from grasping.lab.programs.make_dataset import SHARD, ignore_warning, make_all
from grasping.lab.synthetic import samples
from grasping.lab.synthetic.attempts import attempts
from grasping.network import weights
from grasping.network.maps import PARALLEL
from grasping.network.networks import MapNetwork, frozen
from grasping.poses.lift_network import LiftNetwork, loaded

BELIEVED = "believed"
"""In the name of a shard whose attempts a network of lifts chose."""


class AttemptTask(NamedTuple):
    """A shard to be made."""

    path: Path
    split: str
    numbers: range
    weights: Path
    most: int
    lifts: Path | None


@lru_cache(maxsize=1)
def network(file: Path) -> MapNetwork:
    return frozen(weights.load(file.read_bytes()).network)


@lru_cache(maxsize=8)
def lift_network(file: Path) -> LiftNetwork:
    return loaded(file.read_bytes())


def make_shard(task: AttemptTask) -> None:
    """Makes one shard unless it is there: the scenes' images, and all attempts with the number of their image."""
    if task.path.exists():
        return
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    lifts = None if task.lifts is None else lift_network(task.lifts)
    made = [attempts(task.split, number, network(task.weights), task.most, lifts) for number in task.numbers]
    part = task.path.with_suffix(".part.npz")
    arrays = {name: np.concatenate([getattr(one, name) for one in made]) for name in ("T", "opening", "seen", "reason")}
    image = np.repeat(np.arange(len(made)), [len(one.T) for one in made])
    depth = np.stack([np.round(1e4 * one.depth).astype(np.uint16) for one in made])  # 0.1 mm
    valid = np.stack([one.valid for one in made])
    ggcnn = weights.checked_sha256(task.weights.read_bytes(), None)
    np.savez_compressed(part, depth=depth, valid=valid, image=image, hand=PARALLEL, ggcnn=ggcnn, **arrays)
    part.replace(task.path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the shards go")
    parser.add_argument("weights", type=Path, help="of GG-CNN, whose maps the network sees")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="train_blobs", help="which scenes")
    parser.add_argument("--scenes", type=whole(1, 10**6), default=2000, help=f"how many, a multiple of {SHARD}")
    parser.add_argument("--most", type=whole(8, 1000), default=24, help="attempts in a scene, default 24")
    parser.add_argument("--first", type=whole(0, 10**9), default=0, help="number of the first scene, default 0")
    parser.add_argument("--lifts", type=Path, help="a network of lifts: attempts are those that it believes in")
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many shards at a time")
    given = parser.parse_args()
    if given.scenes % SHARD:
        parser.error(f"--scenes is {given.scenes}, but must be a multiple of {SHARD}.")
    try:
        weights.load(given.weights.read_bytes())
        if given.lifts is not None:
            loaded(given.lifts.read_bytes())
    except (OSError, RigError) as error:
        parser.error(str(error))
    kind = f"{given.split}_{given.most}" + ("" if given.lifts is None else f"_{BELIEVED}")
    tasks = [
        AttemptTask(given.folder / f"{kind}_{first:06d}.npz", given.split, range(first, first + SHARD),
                    given.weights.absolute(), given.most, given.lifts)
        for first in range(given.first, given.first + given.scenes, SHARD)
    ]  # fmt: skip
    try:
        make_all(parser, given.folder, make_shard, tasks, given.processes, "shard")
    except RigError as error:  # without the package of the objects
        parser.error(str(error))
