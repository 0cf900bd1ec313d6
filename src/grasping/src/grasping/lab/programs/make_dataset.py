"""Makes the synthetic data set: shards of labelled depth images, `SHARD` scenes each, resumable.

Labels are of the parallel gripper, or with --hand reflex of the rig's hand; each shard names its hand. With --check
random grasps and their labels go to a file instead, two a scene, for `rosrun rig_simulation lift_grasps.py`, which
lifts them with the ReFlex and compares.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, TypeVar
from zipfile import BadZipFile

import cv2
import mujoco
import numpy as np
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from grasping.lab.evaluation import label_check
from grasping.lab.synthetic import samples
from grasping.lab.synthetic.samples import LabelSettings
from grasping.network.maps import HANDS, PARALLEL

Task = TypeVar("Task")
SHARD = 50
WIDEST_MARGIN_M = 0.05


class ShardTask(NamedTuple):
    """A shard to be made."""

    path: Path  # of the file
    split: str  # of its scenes
    seeds: range  # numbers of its scenes
    settings: LabelSettings = LabelSettings()


def make_all(
    parser: argparse.ArgumentParser,
    folder: Path,
    make: Callable[[Task], object],
    tasks: Sequence[Task],
    processes: int,
    unit: str,
) -> None:
    """Makes the folder and each file in it with a progress bar; what was made by an earlier run stays. If a folder or
    file cannot be written, the program ends with one sentence.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A fork would inherit the locks of the libraries' threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for _ in tqdm(pool.imap_unordered(make, tasks), total=len(tasks), unit=unit):
                pass
    except OSError as error:
        parser.error(f"{error.filename or folder} cannot be written: {error.strerror}.")


def make_shard(task: ShardTask) -> Path:
    """Makes one shard unless it is there."""
    if not task.path.exists():
        _prepare_process()
        made = [samples.sample(samples.view(task.split, seed), task.settings) for seed in task.seeds]
        write_shard(task.path, made, task.settings)
    return task.path


def write_shard(path: Path, made: Sequence[samples.Sample], settings: LabelSettings) -> None:
    """Writes samples to a file, whole or not at all."""
    part = path.with_suffix(".part.npz")
    arrays = {name: np.stack([getattr(s, name) for s in made]) for name in made[0]._fields}
    np.savez_compressed(part, **arrays, **{name: np.array(value) for name, value in settings._asdict().items()})
    part.replace(path)


def label_settings(arrays: Mapping[str, np.ndarray]) -> LabelSettings:
    """Returns what the labels of a shard mean; older shards, which do not say it, are of the parallel gripper. Raises
    RigError for an unknown hand.
    """
    if "hand" not in arrays:
        return LabelSettings()
    settings = LabelSettings(str(arrays["hand"]), float(arrays["margin"]))
    if settings.hand not in HANDS:
        raise RigError(f"Its labels are of the hand {settings.hand!r}, but known are {' and '.join(HANDS)}.")
    return settings


def check_settings(paths: Iterable[Path], wanted: LabelSettings) -> None:
    """Raises RigError if one of the shards that are already there has labels of another meaning."""
    for path in paths:
        if path.exists():
            try:
                with np.load(path, allow_pickle=False) as arrays:
                    found = label_settings(arrays)
            except (ValueError, EOFError, BadZipFile) as error:
                raise RigError(f"{path} is not a shard ({error}): delete it to make it anew.") from error
            if found != wanted:
                raise RigError(
                    f"{path} holds labels of the hand {found.hand} with a margin of {found.margin:g} m, but "
                    f"{wanted.hand} with {wanted.margin:g} m was asked for: use a folder of its own."
                )


def checked_scene(task: tuple[str, int, LabelSettings]) -> dict[str, object]:
    _prepare_process()
    return label_check.scene_grasps(*task)


def _prepare_process() -> None:
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)


def ignore_warning(_text: str) -> None:
    """MuJoCo would write a log file; scenes and trials with a warning are thrown away by their own checks."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="where the shards go")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="train", help="which scenes")
    parser.add_argument("--scenes", type=int, default=3000, help=f"how many, of shards a multiple of {SHARD}")
    parser.add_argument("--hand", choices=HANDS, default=PARALLEL, help=f"that the labels are of, default {PARALLEL}")
    margin_help = f"added to each opening, as far as the hand opens [m], 0 to {WIDEST_MARGIN_M:g}, default 0"
    parser.add_argument("--margin", type=float, default=0.0, help=margin_help)
    parser.add_argument("--check", type=Path, metavar="FILE", help="write random grasps and their labels there instead")
    parser.add_argument("--processes", type=whole(1, 1024), default=1, help="how many at a time")
    arguments = parser.parse_args()
    if (arguments.folder is None) == (arguments.check is None):
        parser.error("Either a folder for the shards is needed, or --check.")
    unit = SHARD if arguments.check is None else 1
    if arguments.scenes < 1 or arguments.scenes % unit:
        multiple = f"a multiple of {SHARD}" if arguments.check is None else "at least 1"
        parser.error(f"--scenes is {arguments.scenes}, but must be {multiple}.")
    if not 0.0 <= arguments.margin <= WIDEST_MARGIN_M:
        parser.error(f"--margin is {arguments.margin:g} m, but must be between 0 and {WIDEST_MARGIN_M:g} m.")
    settings = LabelSettings(arguments.hand, arguments.margin)
    if arguments.check is not None:
        numbers = [(arguments.split, number, settings) for number in range(arguments.scenes)]
        try:
            with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
                scenes = list(tqdm(pool.imap(checked_scene, numbers), total=len(numbers), unit="scene"))
            arguments.check.write_text(json.dumps({"schema": label_check.SCHEMA, "scenes": scenes}) + "\n")
        except OSError as error:
            parser.error(f"{arguments.check} cannot be written: {error.strerror}.")
        return
    tasks = []
    for first in range(0, arguments.scenes, SHARD):
        path = arguments.folder / f"{arguments.split}_{first:06d}.npz"
        tasks.append(ShardTask(path, arguments.split, range(first, first + SHARD), settings))
    try:
        check_settings((task.path for task in tasks), settings)
    except RigError as error:
        parser.error(str(error))
    make_all(parser, arguments.folder, make_shard, tasks, arguments.processes, "shard")
