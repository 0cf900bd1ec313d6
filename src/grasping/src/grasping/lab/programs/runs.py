"""The folder of a training: it belongs to one set of data and settings, and a later call resumes it."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any

import torch

from common.errors import RigError

CHECKPOINT = "checkpoint.pt"
DEVICES = ("auto", "cpu", "cuda")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options that all trainings share."""
    parser.add_argument(
        "--anew", action="store_true", help="start again where RUN holds another training, which is kept"
    )
    parser.add_argument("--device", choices=DEVICES, default="auto", help="default: cuda where there is one")


def identity(settings: dict[str, Any], *data: list[str]) -> str:
    """Returns a hash, hexadecimal, of a training's settings and of the hashes of what it trains and validates on."""
    return hashlib.sha256(json.dumps([settings, data], sort_keys=True).encode()).hexdigest()


def opened(folder: Path, wanted: str, anew: bool) -> dict[str, Any] | None:
    """Returns the checkpoint of an earlier run, None where there is none; creates the folder.

    Args:
        anew: whether to start again where there is another training; its files are kept in a folder `before_` and a
            number.

    Raises:
        RigError: there is another training.
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
    number = 1
    while (kept := folder / f"before_{number}").exists():
        number += 1
    kept.mkdir()
    for path in [p for p in folder.iterdir() if p.is_file()]:
        path.replace(kept / path.name)
    return None


def save(value: object, path: Path) -> None:
    """Writes a torch file whole or not at all."""
    part = path.with_suffix(".part")
    torch.save(value, part)
    part.replace(path)


def device(name: str) -> torch.device:
    """Returns the device of a name in `DEVICES`; auto is a CUDA device where torch sees one.

    Raises:
        RigError: torch sees no CUDA device, but one is wanted.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise RigError("torch sees no CUDA device: train with --device cpu.")
    return torch.device(name)
