"""Recordings as one HDF5 file, laid out as robomimic's: https://robomimic.github.io/docs/datasets/overview.html.

    data                       attributes: total, env_args (JSON), leap_rig (JSON: units, and where each comes from)
    data/demo_0                attributes: num_samples, task
    data/demo_0/obs/KEY        numbers, shape (n, k), and images, shape (n, height, width, 3)
    data/demo_0/actions        shape (n, k)
    data/demo_0/rewards, dones 1 at the end of a success, and at the end
    data/demo_0/policy_led, intervention   who gave each action, bool
    data/demo_0/times          of the rows, since the epoch [s]
    mask/success               names of the demos that succeeded

There is no next_obs: it is the next row of obs."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from leap_rig.recording.dataset import ACTION, ExportedEpisode, about, exported_episodes
from leap_rig.recording.recording_files import RecordingFault

PREFIX = "observation."  # which the group obs says
ENVIRONMENT = {"env_name": "leap_rig", "type": 2, "env_kwargs": {}}  # 2: one of gym, as robomimic counts them


def export(recordings: Sequence[Path], path: Path, fps: int, task: str, **cut: Any) -> int:
    """Writes one file of `exported_episodes`, which takes the `cut`, and returns the number of rows. Raises
    RecordingFault if the file exists or the disk does not take it, or as they do."""
    if path.exists():
        raise RecordingFault(f"{path} exists already, and nothing is overwritten; choose another name.")
    episodes = exported_episodes(recordings, fps, task, **cut)
    with _new_hdf5(path) as file:
        data = file.create_group("data")
        for i, one in enumerate(episodes):
            _write(data.create_group(f"demo_{i}"), one)
        total = sum(len(one.rows.times) for one in episodes)
        texts = {"env_args": json.dumps({**ENVIRONMENT, "fps": fps}), "leap_rig": json.dumps(about(episodes))}
        data.attrs.update(total=total, **texts)
        good = [f"demo_{i}" for i, one in enumerate(episodes) if one.about.get("success")]
        file.create_dataset("mask/success", data=np.array(good, dtype="S"))
    return total


@contextlib.contextmanager
def _new_hdf5(path: Path) -> Iterator[Any]:
    """Opens a new file, and removes it where writing fails; RecordingFault for an OSError."""
    try:
        file = h5py.File(path, "x")
    except OSError as error:
        raise RecordingFault(f"{path} cannot be written: {error}.") from error
    try:
        with file:
            yield file
    except BaseException as error:
        path.unlink()
        if isinstance(error, OSError):
            raise RecordingFault(f"{path} cannot be written: {error}.") from error
        raise


def _write(group: Any, one: ExportedEpisode) -> None:
    n = len(one.rows.times)
    group.attrs.update(num_samples=n, task=one.task)
    vectors = one.vectors()
    group["actions"], group["times"] = vectors.pop(ACTION), one.rows.times
    last = np.arange(n) == n - 1
    group["dones"], group["rewards"] = last.astype(np.int64), last * float(bool(one.about.get("success")))
    for key, rows in one.leader.items():
        group[key] = rows
    for key, rows in vectors.items():
        group[f"obs/{_short(key)}"] = rows
    for key, images in one.images().items():
        shape = one.features[key]["shape"]
        stored = group.create_dataset(
            f"obs/{_short(key)}", (n, *shape), np.uint8, chunks=(1, *shape), compression="gzip", compression_opts=1
        )
        for i, image in enumerate(images):
            stored[i] = image


def _short(key: str) -> str:
    return key[len(PREFIX) :] if key.startswith(PREFIX) else key
