"""Reading the files of recorded or simulated episodes."""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from common.errors import RigError
from grasping.dataset import store
from grasping.dataset.episode import Episode
from grasping.view import VIEWS

HELD_OUT = 5
"""One in so many episodes is kept from training, to say when it is over."""


class Named(NamedTuple):
    """An episode and the name of its file, without the ending."""

    name: str
    episode: Episode


def read(folder: Path, only: Iterable[str] = (), without: Iterable[str] = ()) -> list[Named]:
    """Returns the episodes in a folder and those below it, ordered by name.

    Args:
        folder: where they are.
        only: things of which one was grasped or lay there; all where it is empty.
        without: things of which none was.

    Raises:
        RigError: there is none, or a file is none.
    """
    found = []
    for path in tqdm(sorted(folder.rglob("*" + store.SUFFIX)), unit="episode", desc="read"):
        try:
            episode = store.decode(path.read_bytes())
        except RigError as error:
            raise RigError(f"{path}: {error}") from None
        things = {thing.strip() for thing in episode.metadata.object.split(",")}
        if (not only or things & set(only)) and not things & set(without):
            found.append(Named(path.stem, episode))
    if not found:
        raise RigError(f"{folder} holds no episode of these things: collect some, or run make_episodes.py.")
    return found


def view_of(named: list[Named]) -> str:
    """Returns the view that the pictures of all episodes are of.

    Raises:
        RigError: they are of several, or of one that is not known.
    """
    views = sorted({n.episode.view for n in named})
    if len(views) > 1 or views[0] not in VIEWS:
        raise RigError(
            f"The episodes are of the views {', '.join(views)}, whose grasps have other axes: train on those of one, "
            f"{' or '.join(VIEWS)}."
        )
    return views[0]


def is_held_out(name: str) -> bool:
    """Returns whether training keeps its hands off an episode; depends on its name alone."""
    return zlib.crc32(name.encode()) % HELD_OUT == 0
