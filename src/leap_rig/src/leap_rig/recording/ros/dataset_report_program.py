"""The program dataset_report.py: what recorded episodes are worth before a training."""

from __future__ import annotations

import argparse
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import rospy

import common.errors
from common.command_line import real, whole
from common.ros.files import write_whole
from common.ros.node import run_program
from leap_rig.recording.quality import EpisodeQuality, QualityLimits, compare, episode_quality, film
from leap_rig.recording.quality_page import page, worst_first
from leap_rig.recording.recording_files import MANIFEST, RecordingFault, folder_of
from leap_rig.recording.session import DISCARDED, LABEL, EpisodeFault, episode_folders, read_label


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    errors = (common.errors.RigError, OSError)
    run_program("dataset_report", lambda: report(options), "Interrupted; no page is written.", errors)


def report(options: argparse.Namespace) -> int:
    """Writes the page and prints what is refused; returns 1 if something is."""
    limits = QualityLimits(**{field.name: getattr(options, field.name) for field in fields(QualityLimits)})
    folders = [one for name in options.names for one in _episodes(folder_of(name))]
    episodes = [episode_quality(folder, options.fps, limits) for folder in folders]
    faults, remarks = compare(episodes, limits)
    films = {i: _films(folders[i], episodes[i]) for i in worst_first(episodes)[: options.worst]}
    write_whole(options.page, page(episodes, faults, remarks, films))
    for one in episodes:
        for fault in one.faults:
            print(f"{one.name}: {fault.name}: {fault.why.rstrip('.')}.")
    for fault in faults:
        print(f"{fault.name}: {fault.why}.")
    for remark in remarks:
        print(remark)
    refused = sum(bool(one.faults) for one in episodes)
    print(f"{len(episodes)} episodes, {refused} refused; the page is {options.page}.")
    return int(bool(refused or faults))


def _episodes(folder: Path) -> list[Path]:
    """Returns a recording, or the episodes of a session that are not discarded; raises RecordingFault for none."""
    if (folder / MANIFEST).exists():
        return [folder]
    found = [one for one in episode_folders(folder) if not _is_discarded(one)]
    if not found:
        raise RecordingFault(f"{folder} is neither a recording nor a session with episodes that count.")
    return found


def _films(folder: Path, one: EpisodeQuality) -> dict[str, list[bytes]]:
    """Returns the film of each camera that has one."""
    found = {}
    for name, camera in one.cameras.items():
        with suppress(RecordingFault):  # between the images that were judged
            found[name] = film(folder, camera)
    return {name: images for name, images in found.items() if images}


def _is_discarded(folder: Path) -> bool:
    try:
        return (folder / LABEL).exists() and read_label(folder).outcome == DISCARDED
    except EpisodeFault:
        return False  # it is refused, by name


def _parser() -> argparse.ArgumentParser:
    most_fps, most_shown = 1000, 100
    parser = argparse.ArgumentParser(prog="dataset_report.py", description="Judges episodes before a training.")
    parser.add_argument("names", nargs="+", metavar="NAME", help="recordings, or sessions of episodes")
    where = "where the page goes (default: dataset_report.html)"
    parser.add_argument("--page", type=Path, default=Path("dataset_report.html"), metavar="FILE", help=where)
    parser.add_argument("--fps", type=whole(1, most_fps), default=30, help="rows a second of the dataset (default: 30)")
    shown = "of how many episodes the page has films (default: 5)"
    parser.add_argument("--worst", type=whole(0, most_shown), default=5, help=shown)
    for field in fields(QualityLimits):
        meaning = f"{field.metadata['is']} (default: {field.default:g})"
        parser.add_argument(
            f"--{field.name}", type=real(0.0, field.metadata["to"]), default=field.default, help=meaning
        )
    return parser
