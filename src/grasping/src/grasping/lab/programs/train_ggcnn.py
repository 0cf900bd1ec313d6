"""Trains a grasp network from scratch on a synthetic data set; may be stopped and resumed at any time.

The folder of the run holds checkpoint.pt (to resume, with the same data and settings), weights.pt (the best so far),
settings.json, curves.csv and curves.png.
"""

from __future__ import annotations

import argparse
import hashlib
import io
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.programs import runs
from grasping.lab.training.trainer import NetworkTraining, network_trainer

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
        raise RigError(f"{folder} holds no shard of the split {split}: run make_dataset.py first.")
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
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    settings = NetworkTraining(**{name: getattr(arguments, name) for name in asdict(default)})
    try:
        device = runs.device(arguments.device)
        parts = [load(arguments.data, split, arguments.shards) for split in ("train", "validation")]
        identity = runs.identity(asdict(settings), *(hashes for _, hashes in parts))
        saved = runs.opened(arguments.run, identity, arguments.anew)
    except (RigError, OSError) as error:
        parser.error(str(error))
    train, validation = (samples for samples, _ in parts)
    about = {**asdict(settings), "scenes": len(train["depth"]), "identity": identity}

    def files(mean: nn.Module) -> dict[str, object]:
        return {"weights.pt": {name: value.cpu() for name, value in mean.state_dict().items()}}

    trainer, data = network_trainer(settings, device), (train, validation)
    runs.train(arguments.run, about, saved, trainer, data, arguments.every, files, CURVES)
