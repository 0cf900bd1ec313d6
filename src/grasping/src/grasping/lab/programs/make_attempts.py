"""Makes the data of the network of lifts: shards of depth images with grasps in six degrees of freedom, each tried in
the physics; resumable.

The rig's hand is lifted by another program: --hand reflex --export FILE writes the grasps, `rosrun rig_simulation
lift_grasps.py FILE --shake --tips 0 --results RESULTS` lifts them, and the same call with --results RESULTS instead
makes the shards.
"""

from __future__ import annotations

import argparse
from dataclasses import astuple
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
import torch

from common.command_line import whole
from common.errors import RigError
from grasping.lab.evaluation import lift_file
from grasping.lab.evaluation.trials import FRICTION
from grasping.lab.programs.make_dataset import SHARD, ignore_warning, make_all
from grasping.lab.synthetic import samples
from grasping.lab.synthetic.attempts import Attempts, attempts, lifted
from grasping.lab.synthetic.pose_labels import REASONS
from grasping.network import weights
from grasping.network.maps import HANDS, PARALLEL
from grasping.network.networks import MapNetwork, frozen
from grasping.poses.gripper import GRIPPER, GRIPPER_HELP, GRIPPERS, Gripper, read_gripper
from grasping.poses.hypotheses import Hypotheses
from grasping.poses.lift_network import LiftNetwork, loaded

ATTEMPT = "attempt"
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
    hand: str = PARALLEL
    gripper: Gripper = GRIPPER
    results: Path | None = None  # of the rig's hand


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
    _prepare_process()
    made = [_attempts(task, number) for number in task.numbers]
    reasons = [
        REASONS.index(reason) for one, number in zip(made, task.numbers) for reason in _reasons(task, number, one)
    ]
    part = task.path.with_suffix(".part.npz")
    arrays = {name: np.concatenate([getattr(one.tried, name) for one in made]) for name in Hypotheses._fields}
    image = np.repeat(np.arange(len(made)), [len(one.tried.T) for one in made])
    depth = np.stack([np.round(1e4 * one.image.depth).astype(np.uint16) for one in made])  # 0.1 mm
    valid = np.stack([one.image.valid for one in made])
    ggcnn = weights.checked_sha256(task.weights.read_bytes(), None)
    arrays.update(reason=np.array(reasons, np.uint8), depth=depth, valid=valid, image=image)
    np.savez_compressed(part, hand=task.hand, gripper=astuple(task.gripper), ggcnn=ggcnn, **arrays)
    part.replace(task.path)


def exported(task: tuple[AttemptTask, int]) -> dict[str, Any]:
    """Returns the attempts in one scene of a shard as a file of grasps has them, all with the friction of the first."""
    _prepare_process()
    of, number = task
    made = _attempts(of, number)
    each = zip(made.T_world_grasp, made.tried.opening.tolist(), made.target.tolist())
    grasps = [lift_file.grasp_entry(ATTEMPT, *one, None, own_approach=True) for one in each]
    friction = float(made.friction[0]) if len(made.friction) else FRICTION[0]
    return lift_file.scene_entry(of.split, number, made.scene, friction, grasps)


def _attempts(task: AttemptTask, number: int) -> Attempts:
    lifts = None if task.lifts is None else lift_network(task.lifts)
    return attempts(task.split, number, network(task.weights), task.most, task.gripper, lifts)


def _reasons(task: AttemptTask, number: int, made: Attempts) -> list[str]:
    if task.results is None:
        return lifted(made, task.gripper)
    rows = lift_file.results_by_scene(task.results)[task.split, number]
    if [row["width"] for row in rows] != made.tried.opening.tolist():
        raise RigError(f"{task.results} is not of these attempts in scene {number} of {task.split}.")
    return [row["reason"] for row in rows]


def _prepare_process() -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the shards go")
    parser.add_argument("weights", type=Path, help="of GG-CNN, whose maps the network sees")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="train_blobs", help="which scenes")
    parser.add_argument("--scenes", type=whole(1, 10**6), default=2000, help=f"how many, a multiple of {SHARD}")
    parser.add_argument("--most", type=whole(8, 1000), default=24, help="attempts in a scene, default 24")
    parser.add_argument("--first", type=whole(0, 10**9), default=0, help="number of the first scene, default 0")
    parser.add_argument("--lifts", type=Path, help="a network of lifts: attempts are those that it believes in")
    parser.add_argument("--hand", choices=HANDS, default=PARALLEL, help=f"that lifts, default {PARALLEL}")
    parser.add_argument("--gripper", type=Path, help=GRIPPER_HELP)
    parser.add_argument("--export", type=Path, metavar="FILE", help="write the grasps of the rig's hand there instead")
    parser.add_argument("--results", type=Path, metavar="FILE", help="what lift_grasps.py said of them")
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many shards at a time")
    given = parser.parse_args()
    if (given.hand == PARALLEL) != (given.export is given.results is None) or (given.export and given.results):
        parser.error("With --hand reflex, and only then, either --export or --results is needed.")
    if given.hand != PARALLEL and given.gripper is not None:
        parser.error("--gripper describes a parallel gripper, not the rig's hand.")
    if given.scenes % SHARD:
        parser.error(f"--scenes is {given.scenes}, but must be a multiple of {SHARD}.")
    try:
        weights.load(given.weights.read_bytes())
        gripper = GRIPPERS[given.hand] if given.gripper is None else read_gripper(given.gripper)
        if given.lifts is not None:
            loaded(given.lifts.read_bytes())
    except (OSError, RigError) as error:
        parser.error(str(error))
    kind = f"{given.split}_{given.most}" + ("" if given.lifts is None else f"_{BELIEVED}")
    tasks = [
        AttemptTask(given.folder / f"{kind}_{first:06d}.npz", given.split, range(first, first + SHARD),
                    given.weights.absolute(), given.most, given.lifts, given.hand, gripper, given.results)
        for first in range(given.first, given.first + given.scenes, SHARD)
    ]  # fmt: skip
    if given.export is not None:
        try:
            scenes = [(task, number) for task in tasks for number in task.numbers]
            lift_file.write(given.export, exported, scenes, given.processes)
        except OSError as error:
            parser.error(f"{given.export} cannot be written: {error.strerror}.")
        return
    try:
        make_all(parser, given.folder, make_shard, tasks, given.processes, "shard")
    except RigError as error:  # without the package of the objects
        parser.error(str(error))
