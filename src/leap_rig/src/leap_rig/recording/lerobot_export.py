"""Recordings as a LeRobot dataset (v3), by LeRobot's own library: https://huggingface.co/docs/lerobot. Runs in the
environment of requirements-lerobot.txt, without ROS and without the rig's own environment."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from common.errors import RigError
from leap_rig.recording import topics
from leap_rig.recording.episode import (
    DEPTH_CODE,
    IMAGE,
    TrainingEpisode,
    color_image,
    depth_image,
    training_episode,
)
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders, read
from leap_rig.recording.session import LABEL, read_label
from leap_rig.recording.session import SUCCESS as SUCCEEDED
from leap_rig.recording.signals import SignalTable, moving, read_signals

STATE, ACTION, SUCCESS, IMAGES = "observation.state", "action", "next.success", "observation.images."
KNOWN = {topics.COLOR: "color", topics.DEPTH: "depth"}
"""Names of the rig's own cameras; those of others follow from their topics."""
ABOUT = "meta/leap_rig.json"  # in the dataset's folder: units, and where each episode comes from


class ExportedEpisode(NamedTuple):
    """What a recording gives a dataset."""

    recording: Path
    task: str
    rows: TrainingEpisode
    signals: SignalTable
    cameras: Mapping[str, str]  # topics by key
    features: dict[str, Any]
    about: Mapping[str, Any]


def main() -> None:
    """Exports what the only argument describes in JSON; what ends it goes to stderr."""
    interrupted = 130  # exit code after Ctrl-C
    try:
        options = json.loads(sys.argv[1])
        recordings, folder = [Path(name) for name in options.pop("recordings")], Path(options.pop("folder"))
        export(recordings, folder, **options)
    except (RigError, OSError) as error:
        sys.exit(f"export_recording: {error}")
    except KeyboardInterrupt:
        sys.exit(interrupted)


def export(
    recordings: list[Path],
    folder: Path,
    fps: int,
    task: str,
    start: float = 0.0,
    end: float = float("inf"),
    trim: bool = False,
) -> None:
    """Writes one dataset with an episode for each recording; `task` for those that name none; `start` and `end` cut
    each [s], `trim` cuts what does not move at its ends. Raises RecordingFault if the folder exists, a recording has no
    task, or the recordings do not fit together."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if folder.exists():
        raise RecordingFault(f"{folder} exists already, and nothing is overwritten; choose another folder.")
    episodes = []
    for recording in recordings:
        episodes.append(_episode(recording, fps, task, start, end, trim))
        if episodes[-1].features != episodes[0].features:
            raise RecordingFault(f"{recording} has other signals than the first one, so they are not one dataset.")
    features = deepcopy(episodes[0].features)  # LeRobot adds to it
    robot = str(episodes[-1].about["robot"])
    dataset = LeRobotDataset.create(f"leap_rig/{folder.name}", fps, features, folder, f"leap_rig {robot}")
    for one in episodes:
        images = {key: _images(one.recording, topic, one.rows.times) for key, topic in one.cameras.items()}
        for i in range(len(one.rows.times)):
            vectors = {STATE: one.rows.state[i], ACTION: one.rows.action[i]}
            vectors.update({key: rows[i] for key, rows in one.signals.rows.items()})
            frame: dict[str, Any] = {key: row.astype(np.float32) for key, row in vectors.items()}
            if SUCCESS in one.features:
                frame[SUCCESS] = np.array([bool(one.about["success"])])
            dataset.add_frame({**frame, **{key: next(of) for key, of in images.items()}, "task": one.task})
        dataset.save_episode()
    dataset.finalize()
    about = {"units": {STATE: "rad", ACTION: "rad", **episodes[0].signals.units}, "depth": DEPTH_CODE}
    (folder / ABOUT).write_text(json.dumps({**about, "episodes": [one.about for one in episodes]}, indent=1) + "\n")


def _episode(recording: Path, fps: int, task: str, start: float, end: float, trim: bool) -> ExportedEpisode:
    run = read(recording, start, end)
    words = task or run.manifest.get("task", "")
    if not words:
        raise RecordingFault(f"{recording} does not say what is done; give --task, a sentence.")
    rows = training_episode(run, fps)
    if trim:
        part = moving(rows.action, fps)
        rows = replace(rows, times=rows.times[part], state=rows.state[part], action=rows.action[part])
    signals = read_signals(recording, rows.times, run)
    cameras = {
        IMAGES + (KNOWN.get(topic) or topic.strip("/").replace("/", "_")): topic for topic in _cameras(recording)
    }
    robot = run.manifest.get("robot", {}).get("model", {}).get("robot", "unknown")
    about: dict[str, Any] = {"recording": recording.name, "started": run.manifest.get("started", ""), "robot": robot}
    vector = {"dtype": "float32", "shape": (len(rows.names),), "names": list(rows.names)}
    features: dict[str, Any] = {STATE: vector, ACTION: dict(vector)}
    for key, names in signals.names.items():
        features[key] = {"dtype": "float32", "shape": (len(names),), "names": list(names)}
    for key, topic in cameras.items():
        shapes = {image.shape for image in _images(recording, topic, rows.times)}
        kind = "image" if topic == topics.DEPTH else "video"  # a film would not keep the depth
        features[key] = {"dtype": kind, "shape": next(iter(shapes)), "names": ["height", "width", "channels"]}
    if (recording / LABEL).exists():
        label = read_label(recording)
        about.update(asdict(label), success=label.outcome == SUCCEEDED)
        features[SUCCESS] = {"dtype": "bool", "shape": (1,), "names": None}
    return ExportedEpisode(recording, words, rows, signals, cameras, features, about)


def _cameras(recording: Path) -> list[str]:
    """Returns the topics of a recording on which images came."""
    found = {message.topic for message in between(recording, None, 0.0, float("inf")) if message.kind.name == IMAGE}
    return sorted(found)


def _images(recording: Path, topic: str, times: np.ndarray) -> Iterator[np.ndarray]:
    """Yields for each time the newest image of a topic, or the first one before it came. RecordingFault: their size
    changes, which no video has."""
    decode, newest = MessageDecoders(), None
    picture = depth_image if topic == topics.DEPTH else color_image
    coming_ones = between(recording, [topic], 0.0, float("inf"))
    coming = next(coming_ones, None)
    for time in times:
        while coming is not None and (newest is None or coming.received * 1e-9 <= time):
            image, coming = picture(decode(coming)), next(coming_ones, None)
            if newest is not None and image.shape != newest.shape:
                raise RecordingFault(
                    f"The images of {topic} in {recording} are {newest.shape[1]} x {newest.shape[0]} px, then "
                    f"{image.shape[1]} x {image.shape[0]}: a dataset has one size; record each in a run of its own."
                )
            newest = image
        if newest is None:
            return
        yield newest
