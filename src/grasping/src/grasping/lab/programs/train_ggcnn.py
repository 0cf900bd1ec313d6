"""Trains a grasp network from scratch on a synthetic data set; may be stopped and resumed at any time.

The folder of the run holds checkpoint.pt (to resume, with the same data and settings), weights.pt (the best so far),
settings.json, curves.csv and curves.png.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.lab.programs import runs
from grasping.lab.training.trainer import NetworkTrainer, NetworkTraining

COLUMNS = ("step", "rate", "training", "validation", "quality", "angle", "width", "hits")


def load(folder: Path, split: str, most: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """Returns the samples of at most `most` shards of a split, joined, and the shards' SHA-256, hexadecimal.

    Raises:
        RigError: there is none.
    """
    shards = sorted(p for p in folder.glob(f"{split}_*.npz") if ".part" not in p.name)[:most]
    if not shards:
        raise RigError(f"{folder} holds no shard of the split {split}: run make_dataset.py first.")
    loaded, hashes = [], []
    for shard in tqdm(shards, unit="shard", desc=split):
        content = shard.read_bytes()
        hashes.append(hashlib.sha256(content).hexdigest())
        with np.load(io.BytesIO(content)) as arrays:
            loaded.append(dict(arrays))
    return {name: np.concatenate([part[name] for part in loaded]) for name in loaded[0]}, hashes


def plot(rows: list[dict], path: Path) -> None:
    """Draws the curves."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [float(r["step"]) for r in rows]
    for name in ("training", "validation"):
        left.plot(steps, [float(r[name]) for r in rows], label=name)
    left.set(xlabel="step", ylabel="loss", yscale="log")
    left.legend()
    right.plot(steps, [float(r["hits"]) for r in rows])
    right.set(xlabel="step", ylabel="share of best pixels that are grasps", ylim=(0, 1))
    figure.savefig(path, dpi=110)


def main() -> None:
    default = NetworkTraining()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the shards")
    parser.add_argument("run", type=Path, help="folder of the run; the same training in it is gone on with")
    for name, value in asdict(default).items():
        kind = (lambda text: text == "true") if isinstance(value, bool) else type(value)
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, default=value, help=f"default: {value}")
    runs.add_options(parser)
    parser.add_argument("--every", type=int, default=250, help="steps between validations and checkpoints")
    parser.add_argument("--shards", type=int, default=10**6, help="most shards of each split")
    parser.add_argument("--threads", type=int, default=1, help="of the arithmetic")
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
    trainer, rows, best = NetworkTrainer(settings, device), [], float("inf")
    if saved is not None:
        trainer.resume(saved["trainer"])
        rows, best = saved["rows"], saved["best"]
    (arguments.run / "settings.json").write_text(
        json.dumps({**asdict(settings), "scenes": len(train["depth"]), "identity": identity}, indent=2) + "\n"
    )
    bar = tqdm(total=settings.steps, initial=trainer.step, unit="step", mininterval=10.0)
    recent = []
    while trainer.step < settings.steps:
        rate = trainer.rate()
        recent.append(trainer.train(train))
        bar.update()
        if trainer.step % arguments.every and trainer.step < settings.steps:
            continue
        found = trainer.validate(validation)
        rows.append({"step": trainer.step, "rate": rate, "training": float(np.mean(recent)), **found})
        recent = []
        bar.set_postfix_str(f"loss {found['validation']:.4f}, hits {found['hits']:.2f}")
        if found["validation"] < best:
            best = found["validation"]
            weights = {name: value.cpu() for name, value in trainer.mean.state_dict().items()}
            runs.save(weights, arguments.run / "weights.pt")
        checkpoint = {"identity": identity, "trainer": trainer.state(), "rows": rows, "best": best}
        runs.save(checkpoint, arguments.run / runs.CHECKPOINT)
        with (arguments.run / "curves.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        plot(rows, arguments.run / "curves.png")
