"""Makes the synthetic data set: shards of labelled depth images, `SHARD` scenes each, resumable."""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import mujoco
import numpy as np
from tqdm import tqdm

from grasping.lab.synthetic import samples

Task = TypeVar("Task")
SHARD = 50


def make_all(
    parser: argparse.ArgumentParser,
    folder: Path,
    make: Callable[[Task], object],
    tasks: Sequence[Task],
    processes: int,
    unit: str,
) -> None:
    """Makes the folder and each file in it with a progress bar; what was made by an earlier run stays.

    If a folder or file cannot be written, the program ends with one sentence.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A fork would inherit the locks of the libraries' threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for _ in tqdm(pool.imap_unordered(make, tasks), total=len(tasks), unit=unit):
                pass
    except OSError as error:
        parser.error(f"{error.filename or folder} cannot be written: {error.strerror}.")


def make_shard(task: tuple[Path, str, range]) -> Path:
    """Makes one shard unless it is there."""
    path, split, seeds = task
    if not path.exists():
        cv2.setNumThreads(1)
        mujoco.set_mju_user_warning(ignore_warning)
        write_shard(path, [samples.sample(samples.view(split, seed)) for seed in seeds])
    return path


def write_shard(path: Path, made: Sequence[samples.Sample]) -> None:
    """Writes samples to a file, whole or not at all."""
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, **{name: np.stack([getattr(s, name) for s in made]) for name in made[0]._fields})
    part.replace(path)


def ignore_warning(_text: str) -> None:
    """MuJoCo would write a log file; scenes and trials with a warning are thrown away by their own checks."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the shards go")
    parser.add_argument("--split", choices=sorted(samples.SPLITS), default="train", help="which scenes")
    parser.add_argument("--scenes", type=int, default=3000, help=f"how many, a multiple of {SHARD}")
    parser.add_argument("--processes", type=int, default=1, help="how many at a time")
    arguments = parser.parse_args()
    if arguments.scenes < 1 or arguments.scenes % SHARD:
        parser.error(f"--scenes is {arguments.scenes}, but must be a multiple of {SHARD}.")
    tasks = [
        (arguments.folder / f"{arguments.split}_{first:06d}.npz", arguments.split, range(first, first + SHARD))
        for first in range(0, arguments.scenes, SHARD)
    ]
    make_all(parser, arguments.folder, make_shard, tasks, arguments.processes, "shard")
