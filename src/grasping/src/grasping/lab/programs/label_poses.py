"""Labels grasps in six degrees of freedom by lifting them in the physics, with the arm's error and a shake, and says
on which fraction of the objects some of them lifts: of the sampled ones, chosen after the fact.

Writes one file for each scene, SPLIT_OBJECTS_MOST_DRAWS_NUMBER.npz. An existing file is kept, so a run resumes where it
stopped.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import cv2
import mujoco
import numpy as np
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from common.statistics import proportion
from grasping.lab.evaluation.tables import markdown_table
from grasping.lab.programs.make_dataset import ignore_warning
from grasping.lab.synthetic import pose_labels, samples
from grasping.poses.gripper import GRIPPER, GRIPPER_HELP, Gripper, read_gripper
from grasping.poses.hypotheses import MAX_TILT_RAD

KINDS = {"tilted up to 8 deg": 0.14, "tilted up to 45 deg": MAX_TILT_RAD}
"""Greatest tilt of the grasps of each kind [rad]."""


class PoseTask(NamedTuple):
    """A scene whose grasps are to be labelled."""

    folder: Path
    split: str
    number: int
    objects: int | None  # in the scene, None: as its split has it
    most: int
    draws: int
    gripper: Gripper


def label(task: PoseTask) -> dict[str, np.ndarray]:
    """Returns the reasons of each kind's grasps in a scene, shape (k, draws); makes its file if it is not there."""
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)
    settings = f"{task.objects or 'any'}_{task.most}_{task.draws}"
    path = task.folder / f"{task.split}_{settings}_{task.number:06d}.npz"
    if not path.exists():
        scene = samples.settled(task.split, task.number, task.objects)
        how = tuple(KINDS.values()), task.most, task.draws, task.gripper
        made = pose_labels.labelled_scene(task.split, task.number, scene, *how)
        arrays = {f"{name}_{i}": array for i, of in enumerate(made.grasps) for name, array in of._asdict().items()}
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, target=made.target, friction=made.friction, **arrays)
        part.replace(path)
    with np.load(path, allow_pickle=False) as arrays:
        little, any_tilt = (arrays[f"reason_{i}"] for i in range(len(KINDS)))
    return dict(zip(KINDS, (little, np.concatenate([little, any_tilt]))))


def summary(scenes: Iterable[dict[str, np.ndarray]]) -> str:
    """Returns the table of what the grasps of scenes lift."""
    scenes = list(scenes)
    lines = []
    for name in KINDS:
        lifted = [scene[name] == 0 for scene in scenes]
        once, always = [bool(of[:, 0].any()) for of in lifted], [bool(of.all(axis=1).any()) for of in lifted]
        every = np.concatenate([of.ravel() for of in lifted])
        found = [len(of) > 0 for of in lifted]
        cells = (proportion(found), proportion(once), proportion(always), proportion(every.tolist()))
        lines.append([name, *map(str, cells)])
    header = ("grasps", "some is found %", "some lifts %", "some lifts with each error %", "of all grasps %")
    return markdown_table(header, lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the files go")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="validation", help="which scenes")
    parser.add_argument("--scenes", type=whole(1, 10**6), default=100, help="how many, default 100")
    parser.add_argument("--first", type=whole(0, 10**9), default=0, help="number of the first one, default 0")
    parser.add_argument("--objects", type=whole(1, 10), help="in a scene, where its surroundings do not say how many")
    parser.add_argument("--most", type=whole(1, 1000), default=12, help="grasps of each kind in a scene, default 12")
    parser.add_argument("--draws", type=whole(1, 100), default=3, help="errors of the arm for each, default 3")
    parser.add_argument("--gripper", type=Path, help=GRIPPER_HELP)
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many scenes at a time")
    given = parser.parse_args()
    numbers = range(given.first, given.first + given.scenes)
    try:
        gripper = GRIPPER if given.gripper is None else read_gripper(given.gripper)
        how = given.objects, given.most, given.draws, gripper
        tasks = [PoseTask(given.folder, given.split, n, *how) for n in numbers]
        given.folder.mkdir(parents=True, exist_ok=True)
        with multiprocessing.get_context("spawn").Pool(given.processes) as pool:
            found = list(tqdm(pool.imap(label, tasks), total=len(tasks), unit="scene"))
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename or given.folder} cannot be written: {error.strerror}.")
    sys.stdout.write(summary(found))
