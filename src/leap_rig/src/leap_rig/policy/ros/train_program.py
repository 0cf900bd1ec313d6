"""The program train_policy.py: a policy from recorded episodes."""

from __future__ import annotations

import argparse
from pathlib import Path

import rospy
import torch
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from common.ros.files import write_whole
from common.ros.node import run_program
from leap_rig.policy.network import PolicyAbout, saved
from leap_rig.policy.training import CHUNK, FPS, samples, trained
from leap_rig.recording.recording_files import MANIFEST, RecordingFault, folder_of
from leap_rig.recording.session import SUCCESS, chosen, episode_folders

SMOOTH = 0.98  # of the loss that is shown


def main() -> None:
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program("train_policy", lambda: train(options), "Interrupted; no policy is written.", (RigError, OSError))


def train(options: argparse.Namespace) -> int:
    """Trains and writes the file; returns the exit code. Raises RecordingFault."""
    if options.out.exists():
        raise RecordingFault(f"{options.out} exists already, and nothing is overwritten; choose another name.")
    folders = [one for name in options.names for one in _recordings(folder_of(name))][: options.episodes or None]
    torch.set_num_threads(1)
    parts, tasks = zip(*(samples(one, options.task) for one in tqdm(folders, unit="episode")))
    other = next((i for i, task in enumerate(tasks) if task != tasks[0]), 0)
    if other:
        shown = f"{folders[other]} shows {tasks[other]!r}, but {folders[0]} {tasks[0]!r}"
        raise RecordingFault(f"{shown}, and a policy has one task: leave one out, or give --task.")
    rows = sum(int(part.there[:, 0].sum()) for part in parts)
    if not rows:
        raise RecordingFault("No row of these recordings was led by a hand, so there is nothing to learn from.")
    about = PolicyAbout(tasks[0], FPS, CHUNK, len(parts), "touch" not in options.without, "map" not in options.without)
    with tqdm(total=options.steps, unit="step") as bar:
        seen: list[float] = []

        def tell(loss: float) -> None:
            seen[:] = [SMOOTH * seen[0] + (1.0 - SMOOTH) * loss if seen else loss]
            bar.set_postfix(loss=f"{seen[0]:.3f}", refresh=False)
            bar.update()

        network = trained(parts, about, options.steps, options.seed, tell)
    write_whole(options.out, saved(network))
    print(f"Wrote {options.out} from {len(parts)} episodes with {rows} rows that a hand led.")
    return 0


def _recordings(folder: Path) -> list[Path]:
    """Returns a recording, or of a session the episodes that succeeded; raises EpisodeFault for none."""
    if (folder / MANIFEST).exists() or not episode_folders(folder):
        return [folder]
    return chosen(folder, (SUCCESS,))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="train_policy.py", description="Trains a policy on recorded episodes.")
    parser.add_argument("names", nargs="+", metavar="NAME", help="sessions of record_episodes.py, or recordings")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="the policy, for run_policy.py")
    few = "only the first so many (default: all)"
    parser.add_argument("--episodes", type=whole(1, 10**6), default=0, metavar="N", help=few)
    parser.add_argument("--task", default="", help="what is done, in a sentence (default: as the recordings say)")
    less = "what the policy does not get"
    parser.add_argument("--without", choices=("map", "touch"), action="append", default=[], help=less)
    parser.add_argument("--steps", type=whole(1, 10**7), default=6000, help="of the training (default: 6000)")
    parser.add_argument("--seed", type=whole(0, 2**31 - 1), default=0, help="of the training (default: 0)")
    return parser
