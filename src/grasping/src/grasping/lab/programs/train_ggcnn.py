"""Trains a grasp network on the shards of make_dataset.py and import_grasps.py; may be stopped and resumed at any time.

It begins with random weights, or with those of a file (--from), whose network it then trains.

The folder of the run holds checkpoint.pt (to resume, with the same data and settings), weights.pt (the best so far),
settings.json, curves.csv and curves.png.
"""

from __future__ import annotations

import argparse
import hashlib
import io
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.programs import runs
from grasping.lab.training.trainer import NetworkTraining, network_trainer
from grasping.network import weights

CURVES = runs.Curves(
    ("step", "rate", "training", "validation", "quality", "angle", "width", "hits"),
    losses=("training", "validation"),
    scale="log",
    metric="hits",
    label="fraction of best pixels that are grasps",
)


def load(folder: Path, split: str, most: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """Returns the samples of at most `most` shards of a split, joined, and the shards' SHA-256, hexadecimal.

    Raises RigError if the folder holds no shard of that split.
    """
    shards = sorted(p for p in folder.glob(f"{split}_*.npz") if ".part" not in p.name)[:most]
    if not shards:
        raise RigError(f"{folder} holds no shard of the split {split}: run make_dataset.py or import_grasps.py first.")
    loaded, hashes = [], []
    for shard in tqdm(shards, unit="shard", desc=split):
        content = shard.read_bytes()
        hashes.append(hashlib.sha256(content).hexdigest())
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            loaded.append(dict(arrays))
    return {name: np.concatenate([part[name] for part in loaded]) for name in loaded[0]}, hashes


def main() -> None:
    default = NetworkTraining()
    parser = argparse.ArgumentParser(description=__doc__)
    runs.add_options(parser, "shards", default, every=250)
    parser.add_argument("--shards", type=int, default=10**6, help="most shards of each split")
    parser.add_argument("--from", dest="start", type=Path, metavar="WEIGHTS", help="weight file to begin with")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    settings = NetworkTraining(**{name: getattr(arguments, name) for name in asdict(default)})
    try:
        device = runs.device(arguments.device)
        start = arguments.start and weights.load(arguments.start.read_bytes())
        if start:
            settings = replace(settings, network=start.name)
        parts = [load(arguments.data, split, arguments.shards) for split in ("train", "validation")]
        identity = runs.identity(
            asdict(settings), *(hashes for _, hashes in parts), *([[start.sha256]] if start else [])
        )
        saved = runs.opened(arguments.run, identity, arguments.anew)
    except (RigError, OSError) as error:
        parser.error(str(error))
    train, validation = (samples for samples, _ in parts)
    about = {**asdict(settings), "scenes": len(train["depth"]), "identity": identity}
    if start:
        about["from"] = start.sha256

    def files(mean: nn.Module) -> dict[str, object]:
        return {"weights.pt": weights.state_for_file(settings.network, mean)}

    trainer, data = network_trainer(settings, device, start and start.network), (train, validation)
    runs.train(arguments.run, about, saved, trainer, data, arguments.every, files, CURVES)
