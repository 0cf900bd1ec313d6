"""Recordings as a LeRobot dataset (v3), by LeRobot's own library: https://huggingface.co/docs/lerobot. Runs in the
environment of requirements-lerobot.txt, without ROS and without the rig's own environment."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import RigError
from leap_rig.recording import topics
from leap_rig.recording.episode import TrainingEpisode, color_image, training_episode
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders, read

STATE, ACTION, COLOR = "observation.state", "action", "observation.images.color"


def main() -> None:
    """Exports what the only argument describes in JSON; what ends it goes to stderr."""
    interrupted = 130  # exit code after Ctrl-C
    try:
        options = json.loads(sys.argv[1])
        export([Path(name) for name in options["recordings"]], Path(options["folder"]), options["fps"], options["task"])
    except (RigError, OSError) as error:
        sys.exit(f"export_recording: {error}")
    except KeyboardInterrupt:
        sys.exit(interrupted)


def export(recordings: list[Path], folder: Path, fps: int, task: str) -> None:
    """Writes one dataset with an episode for each recording; `task` for those that name none. Raises RecordingFault if
    the folder exists, a recording has no task, or the recordings do not fit together."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if folder.exists():
        raise RecordingFault(f"{folder} exists already, and nothing is overwritten; choose another folder.")
    episodes: list[tuple[Path, str, TrainingEpisode, dict[str, Any]]] = []
    robot = "unknown"
    for recording in recordings:
        run = read(recording)
        words = task or run.manifest.get("task", "")
        if not words:
            raise RecordingFault(f"{recording} does not say what is done; give --task, a sentence.")
        episode = training_episode(run, fps)
        shapes = {image.shape for image in _images(recording, episode)}
        features = _features(episode, next(iter(shapes), None))
        if episodes and features != episodes[0][-1]:
            raise RecordingFault(f"{recording} has other signals than the first one, so they are not one dataset.")
        episodes.append((recording, words, episode, features))
        robot = run.manifest.get("robot", {}).get("model", {}).get("robot", robot)
    features = deepcopy(episodes[0][-1])  # LeRobot adds to it
    dataset = LeRobotDataset.create(f"leap_rig/{folder.name}", fps, features, folder, f"leap_rig {robot}")
    for recording, words, episode, _ in episodes:
        images = _images(recording, episode)
        for state, action in zip(episode.state, episode.action):
            frame = {STATE: state.astype(np.float32), ACTION: action.astype(np.float32), "task": words}
            image = next(images, None)
            dataset.add_frame(frame if image is None else {**frame, COLOR: image})
        dataset.save_episode()
    dataset.finalize()


def _features(episode: TrainingEpisode, shape: tuple[int, ...] | None) -> dict[str, Any]:
    vector = {"dtype": "float32", "shape": (len(episode.names),), "names": list(episode.names)}
    features: dict[str, Any] = {STATE: vector, ACTION: dict(vector)}
    if shape is not None:
        features[COLOR] = {"dtype": "video", "shape": shape, "names": ["height", "width", "channels"]}
    return features


def _images(recording: Path, episode: TrainingEpisode) -> Iterator[np.ndarray]:
    """Yields for each row of the episode the newest color image, or the first one before it came; none without any.
    RecordingFault: their size changes, which no video has."""
    decode, newest = MessageDecoders(), None
    messages = between(recording, [topics.COLOR], 0.0, float("inf"))
    coming = next(messages, None)
    for time in episode.times:
        while coming is not None and (newest is None or coming.received * 1e-9 <= time):
            image, coming = color_image(decode(coming)), next(messages, None)
            if newest is not None and image.shape != newest.shape:
                raise RecordingFault(
                    f"The color images of {recording} are {newest.shape[1]} x {newest.shape[0]} px, then "
                    f"{image.shape[1]} x {image.shape[0]}: a dataset has one size; record each in a run of its own."
                )
            newest = image
        if newest is None:
            return
        yield newest
