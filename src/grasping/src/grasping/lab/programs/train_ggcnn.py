"""Trains a grasp network on the shards of make_dataset.py and import_grasps.py; may be stopped and resumed at any time.

It begins with random weights, or with those of a file (--from), whose network it then trains.

The folder of the run holds checkpoint.pt (to resume, with the same data and settings), weights.pt (the best so far; it
names the hand whose labels it learned), settings.json, curves.csv and curves.png.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import sys
import zlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from common.command_line import whole
from common.errors import RigError
from common.plausible import FARTHEST_M
from grasping.lab.programs import runs
from grasping.lab.programs.make_dataset import label_settings
from grasping.lab.synthetic.samples import Sample
from grasping.lab.training.trainer import NetworkTrainer, NetworkTraining, images
from grasping.network import weights
from grasping.network.networks import NETWORKS


class LoadedShards(NamedTuple):
    """Labelled images of a folder."""

    samples: dict[str, np.ndarray]  # of all shards, joined
    hashes: list[str]  # SHA-256 of each shard, hexadecimal
    hand: str  # that their labels are of


def load(folder: Path, split: str, most: int) -> LoadedShards:
    """Returns the samples of at most `most` shards of a split. Raises RigError if the folder holds no shard of that
    split, shards for several hands, or a file that is not one or was made of images in another unit.
    """
    shards = sorted(p for p in folder.glob(f"{split}_*.npz") if ".part" not in p.name)[:most]
    if not shards:
        raise RigError(f"{folder} holds no shard of the split {split}: run make_dataset.py or import_grasps.py first.")
    loaded, hashes, hands = [], [], {}
    for shard in tqdm(shards, unit="shard", desc=split):
        content = shard.read_bytes()
        hashes.append(hashlib.sha256(content).hexdigest())
        try:
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                hands[label_settings(arrays).hand] = shard.name
                loaded.append({name: arrays[name] for name in Sample._fields})
        except (ValueError, EOFError, KeyError, BadZipFile, zlib.error) as error:
            raise RigError(f"{shard} is not a shard ({error}): delete it and make it anew.") from None
        farthest = np.abs(loaded[-1]["depth"]).max(initial=0.0)
        if not farthest <= FARTHEST_M:
            raise RigError(
                f"{shard} holds depths {farthest:g} m from their mean: its images were not in metres. Delete it, and "
                "make it anew of images in metres, or in 16-bit millimetres."
            )
    if len(hands) > 1:
        found = " and ".join(f"{name} for the hand {hand}" for hand, name in hands.items())
        raise RigError(f"{folder} holds {found}: keep the shards of each hand in a folder of their own.")
    joined = {name: np.concatenate([part[name] for part in loaded]) for name in loaded[0]}
    return LoadedShards(joined, hashes, next(iter(hands)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    runs.add_options(parser)
    parser.add_argument("--shards", type=whole(1, 10**6), default=10**6, help="most shards of each split")
    parser.add_argument("--from", dest="start", type=Path, metavar="WEIGHTS", help="weight file to begin with")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    settings = NetworkTraining(**{name: getattr(arguments, name) for name in asdict(NetworkTraining())})
    try:
        device = runs.device(arguments.device)
        start = arguments.start and weights.load(arguments.start.read_bytes())
        if start:
            settings = replace(settings, network=start.name)
        side_multiple = int(NETWORKS[settings.network]().side_multiple)  # type: ignore[arg-type]  # a Module's attribute
        if settings.side % side_multiple:
            raise RigError(f"--side is {settings.side}, but {settings.network} needs a multiple of {side_multiple}.")
        parts = [load(arguments.data, split, arguments.shards) for split in ("train", "validation")]
        train, validation = parts
        if train.hand != validation.hand:
            raise RigError(
                f"The shards for training are of the hand {train.hand}, those for validation of {validation.hand}: "
                "make both with the same --hand."
            )
        mismatch = start and start.mismatch(train.hand)
        if mismatch:
            sys.stderr.write(f"{arguments.start}: {mismatch} The training starts from them all the same.\n")
        identity = runs.identity(
            asdict(settings), train.hashes, validation.hashes, *([[start.sha256]] if start else [])
        )
        saved = runs.opened(arguments.run, identity, arguments.anew)
    except (RigError, OSError) as error:
        parser.error(str(error))
    about = {**asdict(settings), "hand": train.hand, "scenes": len(train.samples["depth"]), "identity": identity}
    if start:
        about["from"] = start.sha256

    def content(mean: nn.Module) -> object:
        return weights.state_for_file(settings.network, mean, train.hand)

    trainer = NetworkTrainer(settings, device, start and start.network)
    data = images(train.samples, device), images(validation.samples, device)
    runs.train(arguments.run, about, saved, trainer, data, arguments.every, content)
