"""The run of a training: options, loop, and a folder that belongs to one set of data and settings; resumable."""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn
from tqdm import tqdm

from common.command_line import real, whole
from common.errors import RigError
from grasping.lab.training.trainer import Images, NetworkTrainer, NetworkTraining
from grasping.network.depth_image import NETWORK_SIDE
from grasping.network.networks import NETWORKS

Value = TypeVar("Value")

CHECKPOINT = "checkpoint.pt"
DEVICES = ("auto", "cpu", "cuda")
BOOLEANS = {"true": True, "false": False}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments and options of a run, and one option for each field of `NetworkTraining`."""
    many = 10**7
    parser.add_argument("data", type=Path, help="folder of the shards")
    parser.add_argument("run", type=Path, help="folder of the run; the same training in it is resumed")
    kinds = {
        "network": _one_of({name: name for name in NETWORKS}), "half": _one_of(BOOLEANS), "seed": whole(0, 2**32 - 1),
        "steps": whole(1, many), "warm_up": whole(0, many), "count": whole(1, 4096), "side": whole(1, NETWORK_SIDE),
        "rate": real(0.0, 1.0, open_low=True), "decay": real(0.0, 1.0), "memory": real(0.0, 0.999999),
    }  # fmt: skip
    for name, value in asdict(NetworkTraining()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=kinds[name], default=value, help=f"default: {value}")
    anew = "start again where RUN holds another training, which is kept"
    parser.add_argument("--anew", action="store_true", help=anew)
    parser.add_argument("--device", choices=DEVICES, default="auto", help="default: cuda where there is one")
    parser.add_argument("--every", type=whole(1, many), default=250, help="steps between validations and checkpoints")
    parser.add_argument("--threads", type=whole(1, 1024), default=1, help="of the arithmetic")


def _one_of(values: Mapping[str, Value]) -> Callable[[str], Value]:
    def read(text: str) -> Value:
        if text not in values:
            raise argparse.ArgumentTypeError(f"{text!r} is not one of {', '.join(values)}")
        return values[text]

    return read


def identity(settings: dict[str, Any], *data: list[str]) -> str:
    """Returns a hash, hexadecimal, of a training's settings and of the hashes of what it trains and validates on."""
    return hashlib.sha256(json.dumps([settings, data], sort_keys=True).encode()).hexdigest()


def opened(folder: Path, wanted: str, anew: bool) -> dict[str, Any] | None:
    """Returns an earlier run's checkpoint, or None; creates the folder. Raises RigError if it holds another training,
    unless `anew`, which moves that one's files into a folder `before_` and a number.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT
    if not checkpoint.exists():
        return None
    saved: dict[str, Any] = torch.load(checkpoint, map_location="cpu", weights_only=True)
    if saved.get("identity") == wanted:
        return saved
    if not anew:
        raise RigError(
            f"{folder} holds a training on other data or with other settings: name another folder, or start again with "
            "--anew, which keeps the old files beside the new ones."
        )
    kept = next(path for path in (folder / f"before_{n}" for n in count(1)) if not path.exists())
    kept.mkdir()
    for path in [p for p in folder.iterdir() if p.is_file()]:
        path.replace(kept / path.name)
    return None


def save(value: object, path: Path) -> None:
    part = path.with_suffix(".part")
    torch.save(value, part)
    part.replace(path)


def device(name: str) -> torch.device:
    """Returns the device of a name in `DEVICES`; auto is CUDA if torch sees it, cuda raises RigError if not."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise RigError("torch sees no CUDA device: train with --device cpu.")
    return torch.device(name)


def train(
    folder: Path,
    settings: dict[str, Any],
    saved: dict[str, Any] | None,
    trainer: NetworkTrainer,
    data: tuple[Images, Images],
    every: int,
    weights: Callable[[nn.Module], object],
) -> None:
    """Trains to the last step; every `every` steps it validates and writes a checkpoint and the curves. `settings`:
    what settings.json says, with the training's identity; `saved`: the checkpoint of `opened`; `data`: for training and
    for validation; `weights`: returns the content of weights.pt, of the mean network that validates best so far.
    """
    (folder / "settings.json").write_text(json.dumps(settings, indent=2) + "\n")
    rows: list[dict] = []
    if saved is not None:
        trainer.resume(saved["trainer"])
        rows = saved["rows"]
    bar = tqdm(total=trainer.steps, initial=trainer.step, unit="step", mininterval=10.0)
    losses = []
    while trainer.step < trainer.steps:
        rate = trainer.rate()
        losses.append(trainer.train(data[0]))
        bar.update()
        if trainer.step % every and trainer.step < trainer.steps:
            continue
        found = trainer.validate(data[1])
        if found["validation"] < min((r["validation"] for r in rows), default=float("inf")):
            save(weights(trainer.mean), folder / "weights.pt")
        rows.append({"step": trainer.step, "rate": rate, "training": float(np.mean(losses)), **found})
        losses = []
        bar.set_postfix_str(f"loss {found['validation']:.4f}, hits {found['hits']:.2f}")
        checkpoint = {"identity": settings["identity"], "trainer": trainer.state(), "rows": rows}
        save(checkpoint, folder / CHECKPOINT)
        with (folder / "curves.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        plot(rows, folder / "curves.png")


def plot(rows: list[dict], path: Path) -> None:
    """Draws the losses and, beside them, the hits; the rows may be those of a curves.csv, texts."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [float(r["step"]) for r in rows]
    for name in ("training", "validation"):
        left.plot(steps, [float(r[name]) for r in rows], label=name)
    left.set(xlabel="step", ylabel="loss", yscale="log")
    left.legend()
    right.plot(steps, [float(r["hits"]) for r in rows])
    right.set(xlabel="step", ylabel="fraction of best pixels that are grasps", ylim=(0, None))
    part = path.with_suffix(".part")  # a viewer that watches the file sees whole pictures
    figure.savefig(part, dpi=110, format="png")
    part.replace(path)
