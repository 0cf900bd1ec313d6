"""Makes the synthetic data set: shards of labelled depth images, `SHARD` scenes each, resumable.

Labels are of the parallel gripper, or with --hand reflex of the rig's hand; each shard names its hand. With --check
random grasps and their labels go to a file instead, two a scene, for `rosrun rig_simulation lift_grasps.py`, which
lifts them with the ReFlex and compares.
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from zipfile import BadZipFile

import cv2
import mujoco
import numpy as np
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from common.poses import pose
from common.rotations import rotation_about
from grasping.lab.evaluation import lift_file
from grasping.lab.evaluation.lifting import nearest_object
from grasping.lab.evaluation.trials import FRICTION
from grasping.lab.synthetic import labels, samples
from grasping.lab.synthetic.samples import LabelSettings
from grasping.network.maps import HANDS, PARALLEL, Peak

Task = TypeVar("Task")
SHARD = 50
RANDOM, BEST = "random grasp", "best label"


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


def checked_scene(task: tuple[str, int, LabelSettings]) -> dict[str, Any]:
    _prepare_process()
    return scene_grasps(*task)


def scene_grasps(split: str, number: int, settings: samples.LabelSettings) -> dict[str, Any]:
    """Returns a scene as a file of grasps has it, with its best label, if any, and a random grasp: a pixel of an object
    and a direction that depend on the scene's number alone, so that labels of several hands are judged on the same.
    """
    seen = samples.view(split, number)
    of_hand = samples.hand_grasps(seen, settings)
    rng = np.random.default_rng([77, number])
    friction, turned = float(rng.uniform(*FRICTION)), int(rng.integers(2))
    best = of_hand.in_image(labels.best(of_hand.found))
    pixel = np.unravel_index(np.argmax(best.quality), best.quality.shape)
    chosen = {BEST: (pixel, best)} if best.quality[pixel] > 0.0 else {}
    rows, columns = np.nonzero(heights(seen, of_hand) > labels.LOWEST_OBJECT_M)
    i, k = rng.integers(len(rows)), rng.integers(len(of_hand.found.angles))
    angle, score = of_hand.found.angles[k], of_hand.found.scores[k]
    one = labels.Labels(score, np.full_like(score, angle), of_hand.found.openings[k], np.ones_like(score, bool))
    chosen[RANDOM] = (rows[i], columns[i]), of_hand.in_image(one)
    grasps = []
    for method, (at, label) in chosen.items():
        d = float(of_hand.exact[at])
        T_camera_grasp = pose(rotation_about(2, np.pi * turned - float(label.angle[at])), d * _ray(at, of_hand))
        T = pose(seen.camera.R, seen.camera.position) @ T_camera_grasp
        peak = Peak(int(at[0]), int(at[1]), *(float(v[at]) for v in (label.quality, label.angle, label.opening)))
        target = nearest_object(seen.scene, T[:3, 3])
        grasps.append(lift_file.grasp_entry(method, T, peak.width * d / of_hand.focal, target, peak))
    return lift_file.scene_entry(split, number, seen.scene, friction, grasps)


def heights(seen: samples.SceneView, of_hand: samples.SceneGrasps) -> np.ndarray:
    """Returns the height above the table that each pixel of the network's image sees, shape (300, 300) [m]."""
    rays = _ray(np.indices(of_hand.exact.shape), of_hand)
    return seen.camera.position[2] + np.tensordot(seen.camera.R[2], rays, 1) * of_hand.exact


def _ray(at: Any, of_hand: samples.SceneGrasps) -> np.ndarray:
    """Returns the viewing directions of pixels (row, column) with z = 1, shape (3, ...)."""
    row, column = np.asarray(at[0]), np.asarray(at[1])
    middle = 0.5 * (len(of_hand.exact) - 1)
    return np.stack([(column - middle) / of_hand.focal, (row - middle) / of_hand.focal, np.ones(row.shape)])


def _prepare_process() -> None:
    cv2.setNumThreads(1)
    mujoco.set_mju_user_warning(ignore_warning)


def ignore_warning(_text: str) -> None:
    """MuJoCo would write a log file; scenes and trials with a warning are thrown away by their own checks."""


def main() -> None:
    widest_margin_m = 0.05
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", help="where the shards go")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="train", help="which scenes")
    parser.add_argument("--scenes", type=int, default=3000, help=f"how many, of shards a multiple of {SHARD}")
    parser.add_argument("--hand", choices=HANDS, default=PARALLEL, help=f"that the labels are of, default {PARALLEL}")
    margin_help = f"added to each opening, as far as the hand opens [m], 0 to {widest_margin_m:g}, default 0"
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
    if not 0.0 <= arguments.margin <= widest_margin_m:
        parser.error(f"--margin is {arguments.margin:g} m, but must be between 0 and {widest_margin_m:g} m.")
    settings = LabelSettings(arguments.hand, arguments.margin)
    if arguments.check is not None:
        numbers = [(arguments.split, number, settings) for number in range(arguments.scenes)]
        try:
            lift_file.write(arguments.check, checked_scene, numbers, arguments.processes)
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
