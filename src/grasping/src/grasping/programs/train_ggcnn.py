"""Trains a grasp network from nothing on a synthetic data set; ends and goes on at any time.

The folder of the run holds checkpoint.pt (to go on), weights.pt (the best so far), curves.csv and curves.png.
"""

from __future__ import annotations

import argparse
import csv
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from common.errors import RigError
from grasping.training.trainer import Settings, Trainer

COLUMNS = ("step", "rate", "training", "validation", "quality", "angle", "width", "hits")


def load(folder: Path, split: str, most: int) -> dict[str, np.ndarray]:
    """Returns the samples of at most `most` shards of a split, joined.

    Raises:
        RigError: there is none.
    """
    shards = sorted(p for p in folder.glob(f"{split}_*.npz") if ".part" not in p.name)[:most]
    if not shards:
        raise RigError(f"{folder} holds no shard of the split {split}: run make_dataset.py first.")
    loaded = []
    for shard in tqdm(shards, unit="shard", desc=split):
        with np.load(shard) as arrays:
            loaded.append(dict(arrays))
    return {name: np.concatenate([part[name] for part in loaded]) for name in loaded[0]}


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


def save(value: object, path: Path) -> None:
    """Writes a torch file whole or not at all."""
    part = path.with_suffix(".part")
    torch.save(value, part)
    part.replace(path)


def main() -> None:
    default = Settings()
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the shards")
    parser.add_argument("run", type=Path, help="folder of the run; a checkpoint in it is gone on from")
    for name, value in asdict(default).items():
        kind = (lambda text: text == "true") if isinstance(value, bool) else type(value)
        parser.add_argument(f"--{name.replace('_', '-')}", type=kind, default=value, help=f"default: {value}")
    parser.add_argument("--every", type=int, default=250, help="steps between validations and checkpoints")
    parser.add_argument("--shards", type=int, default=10**6, help="most shards of each split")
    parser.add_argument("--threads", type=int, default=1, help="of the arithmetic")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    settings = Settings(**{name: getattr(arguments, name) for name in asdict(default)})
    try:
        train, validation = (load(arguments.data, split, arguments.shards) for split in ("train", "validation"))
    except RigError as error:
        parser.error(str(error))
    arguments.run.mkdir(parents=True, exist_ok=True)
    trainer, rows, best = Trainer(settings), [], float("inf")
    checkpoint = arguments.run / "checkpoint.pt"
    if checkpoint.exists():
        saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
        trainer.resume(saved["trainer"])
        rows, best = saved["rows"], saved["best"]
    (arguments.run / "settings.json").write_text(
        json.dumps({**asdict(settings), "scenes": len(train["depth"])}, indent=2) + "\n"
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
            save(trainer.mean.state_dict(), arguments.run / "weights.pt")
        save({"trainer": trainer.state(), "rows": rows, "best": best}, checkpoint)
        with (arguments.run / "curves.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        plot(rows, arguments.run / "curves.png")
