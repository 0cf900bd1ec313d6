"""The program export_recording.py: recordings for others' tools."""

from __future__ import annotations

import argparse
import gzip
import importlib.util
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rospy

import common.errors
from common.command_line import whole
from common.episode_marks import SUCCESS
from common.ros.node import run_program
from leap_rig.recording import csv_export, hdf5_export, lerobot_export, rows_export
from leap_rig.recording.recording_files import (
    MANIFEST,
    MESSAGES,
    RecordingFault,
    between,
    folder_of,
    new_file,
    verify,
    write_mcap,
)
from leap_rig.recording.run import RecordedRun, read
from leap_rig.recording.session import OUTCOMES, chosen, episode_folders

SOURCES = (Path(lerobot_export.__file__).parents[2], Path(common.errors.__file__).parents[1])
PROGRAM = "from leap_rig.recording.{}_export import main; main()"
ERRORS = (common.errors.RigError, OSError)
DATASETS = "lerobot", "hdf5", "rows"  # options that write rows of several recordings
SMALLEST = 16  # images [px]
WORKSPACE = Path(__file__).resolve().parents[6]


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("export_recording", lambda: export(options), "Interrupted; what was written is not complete.", ERRORS)


def export(options: argparse.Namespace) -> int:
    _refuse_unheeded(options)
    folders = [one for name in options.names for one in _recordings(folder_of(name), options.outcome)]
    for folder in folders:
        manifest, remark = verify(folder)
        if remark:
            print(remark, file=sys.stderr)
    cut = {"start": options.start, "end": options.end, "trim": options.trim, "size": options.size}
    cut["robot"] = options.robot
    if options.lerobot is not None:
        return _to_lerobot(folders, options, cut)
    for path, writer in ((options.hdf5, hdf5_export), (options.rows, rows_export)):
        if path is not None:
            count = writer.export(folders, path, options.fps, options.task, **cut)
            print(f"Wrote {len(folders)} episodes with {count} rows to {path}.")
            return 0
    if len(folders) != 1:
        raise RecordingFault("One file holds one recording; name one.")
    (folder,) = folders
    if options.frames is not None:
        texts = read(folder, options.start, options.end).frames
        frames = [line for text in texts if '"hands"' in text and (line := _line(text)) is not None]
        if not frames:
            raise RecordingFault(f"{folder} has no tracker frames in this time, so nothing is written.")
        with new_file(options.frames) as file, gzip.open(file, "wb") as packed:
            packed.writelines(frames)
        print(f"Wrote {len(frames)} frames to {options.frames}.")
        return 0
    if options.ros2 is not None:
        return _to_ros2(folder, options)
    if options.csv is not None:
        return _to_csv(read(folder, options.start, options.end), options.csv)
    names = [MANIFEST, *sorted(name for name in manifest["files"] if name != MESSAGES)]
    files = {name: (folder / name).read_bytes() for name in names}
    count = write_mcap(options.mcap, between(folder, options.topic, options.start, options.end), files)
    print(f"Wrote {count} messages to {options.mcap}.")
    return 0


def _recordings(folder: Path, outcomes: list[str] | None) -> list[Path]:
    """Returns a recording, or of a session of episodes those with these outcomes; raises EpisodeFault for none."""
    if (folder / MANIFEST).exists() or not episode_folders(folder):
        return [folder]
    return chosen(folder, tuple(outcomes or (SUCCESS,)))


def _to_csv(run: RecordedRun, folder: Path) -> int:
    """Writes a file for each series that has rows; removes what it wrote where that fails."""
    found = [series for series in csv_export.SERIES if len(getattr(run, series.times))]
    if not found:
        raise RecordingFault("The recording has no poses, joints or goals in this time, so nothing is written.")
    try:
        folder.mkdir()
    except OSError as error:
        raise RecordingFault(f"{folder} cannot be made: {error.strerror}.") from error
    try:
        for series in found:
            with new_file(folder / f"{series.field}.csv") as file:
                file.writelines(f"{line}\n".encode() for line in csv_export.lines(run, series))
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    rows = ", ".join(f"{series.field}.csv with {len(getattr(run, series.times))} rows" for series in found)
    print(f"Wrote to {folder}: {rows}.")
    return 0


def _refuse_unheeded(options: argparse.Namespace) -> None:
    """Raises RecordingFault for an option that this export would not heed."""
    if options.mcap is not None or options.ros2 is not None:
        return
    to = next(f"--{name}" for name in ("frames", "csv", *DATASETS) if getattr(options, name) is not None)
    given = {"--topic": options.topic is not None, "--trim": options.trim, "--size": options.size}
    given["--robot"] = options.robot
    if to[2:] in DATASETS:
        given = {"--topic": given["--topic"]}
    for option in (option for option, is_given in given.items() if is_given):
        raise RecordingFault(f"{option} is not for {to}, so nothing is written; leave it out.")


def _size(text: str) -> list[int]:
    """The type of --size."""
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if found is None or min(map(int, found.groups())) < SMALLEST:
        raise argparse.ArgumentTypeError(f"{text!r} is no size; one is like 160x120, at least {SMALLEST} px each")
    return [int(one) for one in found.groups()]


def _line(text: str) -> bytes | None:
    """Returns a frame as a line of its own; None for what is no text, and so no frame."""
    try:
        return (text.translate({ord("\n"): " ", ord("\r"): " "}) + "\n").encode()
    except UnicodeEncodeError:
        return None


def _to_lerobot(folders: list[Path], options: argparse.Namespace, cut: Mapping[str, Any]) -> int:
    if importlib.util.find_spec("lerobot") is not None:
        lerobot_export.export(folders, options.lerobot, options.fps, options.task, **cut)
    else:
        request = {
            "recordings": [str(folder.resolve()) for folder in folders],
            "folder": str(options.lerobot.resolve()),
        }
        code = _elsewhere(
            "LeRobot", "lerobot", options.python, {**request, "fps": options.fps, "task": options.task, **cut}
        )
        if code:
            return code
    print(f"Wrote the dataset {options.lerobot}.")
    return 0


def _to_ros2(folder: Path, options: argparse.Namespace) -> int:
    request = {"recording": str(folder.resolve()), "folder": str(options.ros2.resolve()), "topics": options.topic}
    code = _elsewhere("ROS 2", "ros2", options.python, {**request, "start": options.start, "end": options.end})
    if not code:
        print(f"Wrote the bag {options.ros2}.")
    return code


def _elsewhere(name: str, target: str, given: Path | None, request: dict[str, Any]) -> int:
    """Runs an export in the environment of a library of this name, which a target of make installs; returns the exit
    code. Raises RecordingFault without it."""
    python = given or WORKSPACE / f".venv-{target}" / "bin" / "python"
    if not python.is_file():
        raise RecordingFault(
            f"{name} is not installed: {python} is missing. `make {target}` installs it in the clone; from an install "
            f"space, name the clone's .venv-{target}/bin/python with --python."
        )
    command = [str(python), "-c", PROGRAM.format(target), json.dumps(request)]
    environment = {"PYTHONPATH": ":".join(map(str, SOURCES)), "HF_HUB_OFFLINE": "1", "HOME": str(Path.home())}
    return subprocess.run(command, env=environment, check=False).returncode


def _parser() -> argparse.ArgumentParser:
    most_fps = 1000
    parser = argparse.ArgumentParser(prog="export_recording.py", description="Exports recordings for other tools.")
    parser.add_argument("names", nargs="+", metavar="NAME", help="recordings, or sessions; several are one dataset")
    only = "episodes of a session with this outcome (default: success)"
    parser.add_argument("--outcome", choices=OUTCOMES, action="append", help=only)
    to = parser.add_mutually_exclusive_group(required=True)
    to.add_argument("--mcap", type=Path, metavar="FILE", help="one MCAP file with messages of ROS 1, for Foxglove")
    to.add_argument("--ros2", type=Path, metavar="DIR", help="a bag with messages of ROS 2, for its tools")
    to.add_argument("--frames", type=Path, metavar="FILE", help="the tracker's frames, one a line, .jsonl.gz")
    to.add_argument("--csv", type=Path, metavar="DIR", help="a folder of CSV files: poses, joints, goals, hand")
    to.add_argument("--lerobot", type=Path, metavar="DIR", help="a LeRobot dataset, v3")
    to.add_argument("--hdf5", type=Path, metavar="FILE", help="the same rows as one HDF5 file, laid out as robomimic's")
    to.add_argument("--rows", type=Path, metavar="FILE", help="the same rows as one MCAP file of JSON messages")
    parser.add_argument("--fps", type=whole(1, most_fps), default=30, help="rows a second of the dataset (default: 30)")
    parser.add_argument("--trim", action="store_true", help="of a dataset: leave out what does not move at the ends")
    small = "width and height of its images, such as 160x120 (default: as they were taken)"
    parser.add_argument("--size", type=_size, metavar="WxH", help=small)
    robot = "of a dataset: only what LeRobot records of --robot.type=leap_rig, so that its policies move the rig"
    parser.add_argument("--robot", action="store_true", help=robot)
    parser.add_argument("--task", default="", help="what is done, in a sentence, if the recording does not say it")
    python = "Python with LeRobot, or with ROS 2 (default: that of `make lerobot` or `make ros2`)"
    parser.add_argument("--python", type=Path, help=python)
    parser.add_argument("--topic", nargs="*", help="topics of the MCAP file or the bag (default: all)")
    begin = "of one file: begin so long after the start"
    parser.add_argument("--from", dest="start", type=float, default=0.0, metavar="S", help=begin)
    end = "end there, seconds after the start"
    parser.add_argument("--to", dest="end", type=float, default=math.inf, metavar="S", help=end)
    return parser
