"""Recordings as a LeRobot dataset (v3), by LeRobot's own library: https://huggingface.co/docs/lerobot. Runs in the
environment of requirements-lerobot.txt, without ROS and without the rig's own environment."""

from __future__ import annotations

import json
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np

from common.errors import RigError
from leap_rig.recording.dataset import SUCCESS, about, exported_episodes
from leap_rig.recording.recording_files import RecordingFault

ABOUT = "meta/leap_rig.json"  # in the dataset's folder


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


def export(recordings: list[Path], folder: Path, fps: int, task: str, **cut: Any) -> None:
    """Writes one dataset of `exported_episodes`, which takes the `cut`. Raises RecordingFault if the folder exists, or
    as they do."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    if folder.exists():
        raise RecordingFault(f"{folder} exists already, and nothing is overwritten; choose another folder.")
    episodes = exported_episodes(recordings, fps, task, **cut)
    features = deepcopy(episodes[0].features)  # LeRobot adds to it
    robot = str(episodes[-1].about["robot"])
    dataset = LeRobotDataset.create(f"leap_rig/{folder.name}", fps, features, folder, f"leap_rig {robot}")
    for one in episodes:
        vectors, images = one.vectors(), one.images()
        for i in range(len(one.rows.times)):
            frame: dict[str, Any] = {key: rows[i] for key, rows in vectors.items()}
            frame.update((key, rows[i : i + 1]) for key, rows in one.leader.items())
            if SUCCESS in one.features:
                frame[SUCCESS] = np.array([bool(one.about["success"])])
            dataset.add_frame({**frame, **{key: next(of) for key, of in images.items()}, "task": one.task})
        dataset.save_episode()
    dataset.finalize()
    (folder / ABOUT).write_text(json.dumps(about(episodes), indent=1) + "\n")
