"""Reading the files of recorded or simulated episodes."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from common.errors import RigError
from grasping.lab.dataset import store
from grasping.lab.dataset.episode import Episode
from grasping.network.depth_image import VIEWS
from grasping.network.refinement_file import Origin

HELD_OUT = 5
"""One in this many episodes is held out of training and decides when it stops."""


class Named(NamedTuple):
    """An episode, the name of its file, without the ending, and the SHA-256 of its content, hexadecimal."""

    name: str
    episode: Episode
    sha256: str


def read(folder: Path, only: Iterable[str] = (), without: Iterable[str] = ()) -> list[Named]:
    """Returns the episodes in a folder and those below it, ordered by name.

    Args:
        folder: where they are.
        only: things of which one was grasped or lay there; all where it is empty.

    Raises:
        RigError: the folder holds no such episode, or a file is not one.
    """
    found = []
    for path in tqdm(sorted(folder.rglob("*" + store.SUFFIX)), unit="episode", desc="read"):
        content = path.read_bytes()
        try:
            episode = store.decode(content)
        except RigError as error:
            raise RigError(f"{path}: {error}") from None
        things = {thing.strip() for thing in episode.metadata.object.split(",")}
        if (not only or things & set(only)) and not things & set(without):
            found.append(Named(path.stem, episode, hashlib.sha256(content).hexdigest()))
    if not found:
        raise RigError(f"{folder} holds no episode of these things: collect some, or run make_episodes.py.")
    return found


def origin_of(named: list[Named], mixed: bool = False) -> Origin:
    """Returns the rig of which all episodes are.

    Args:
        mixed: whether they may be of several rigs; the origin does not know what differs among them.

    Raises:
        RigError: they are of several views, or of one that is not known; or of several rigs, and are not to be.
    """
    views = sorted({n.episode.view for n in named})
    if len(views) > 1 or views[0] not in VIEWS:
        raise RigError(
            f"The episodes are of the views {', '.join(views)}, whose grasps have other axes: train on those of one, "
            f"{' or '.join(VIEWS)}."
        )
    first, *others = (asdict(Origin.of(n.episode.metadata.configuration)) for n in named)
    pairs = zip(named[1:], others)
    differing = {name: n.name for n, other in pairs for name in first if first[name] != other[name]}
    if differing and not mixed:
        name, other = next(iter(differing.items()))
        raise RigError(
            f"The episodes are of several rigs, {named[0].name} and {other} differ in {name}: train on those of one, "
            "or with --mixed."
        )
    return Origin(**{**first, **dict.fromkeys(differing)})


def is_held_out(name: str) -> bool:
    """Returns whether an episode is held out of training; depends on its name alone."""
    return zlib.crc32(name.encode()) % HELD_OUT == 0
