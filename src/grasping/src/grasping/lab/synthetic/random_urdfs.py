"""The objects `random_urdfs` that the package pybullet carries: a thousand blobs of convex parts.

Numbers below 600 may be trained on, the next hundred chosen by; those from 700 on are in evaluations only.
"""

from __future__ import annotations

import importlib.util
from functools import lru_cache
from pathlib import Path

import numpy as np

from common.errors import RigError
from grasping.lab.synthetic.shapes import Geom, Shape

TRAINED, CHOSEN_BY, KEPT = range(600), range(600, 700), range(700, 1000)
THINNEST_M, SHORTEST_M = 0.015, 0.03  # of an object that is used: some are splinters
SCALE = 0.015  # of the files' vertices, as the URDFs say [m]


def seen_blob(rng: np.random.Generator) -> Shape:
    """Returns one of the objects that may be trained on."""
    return _any_of(rng, TRAINED)


def other_blob(rng: np.random.Generator) -> Shape:
    """Returns one of the objects by which a training's result is chosen."""
    return _any_of(rng, CHOSEN_BY)


def kept_blob(rng: np.random.Generator) -> Shape:
    """Returns one of the objects that training never sees."""
    return _any_of(rng, KEPT)


def _any_of(rng: np.random.Generator, numbers: range) -> Shape:
    while not is_used(number := int(rng.integers(numbers.start, numbers.stop))):
        pass
    return blob(number)


def is_used(number: int) -> bool:
    """Whether an object is no splinter."""
    extents = np.ptp([vertex for part in blob(number) for vertex in part.vertices], axis=0)
    return bool(extents.min() >= THINNEST_M and extents.max() >= SHORTEST_M)


@lru_cache(maxsize=1000)
def blob(number: int) -> Shape:
    """Returns an object by its number, 0 to 999; raises RigError where pybullet's files are missing."""
    file = folder() / f"{number:03d}" / f"{number:03d}.obj"
    try:
        lines = file.read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"{file} cannot be read: {error}.") from error
    parts: list[list[list[float]]] = []
    for line in lines:
        word, _, rest = line.partition(" ")
        if word == "o":
            parts.append([])
        elif word == "v":
            parts[-1].append([SCALE * float(number) for number in rest.split()[:3]])
    middle = np.mean([vertex for part in parts for vertex in part], axis=0)
    return tuple(Geom("mesh", (), vertices=tuple(map(tuple, (np.array(part) - middle).tolist()))) for part in parts)


def folder() -> Path:
    """Returns where the objects are; raises RigError without the package pybullet."""
    found = importlib.util.find_spec("pybullet_data")
    if found is None or found.origin is None:
        raise RigError("The objects random_urdfs come with the package pybullet, which is not installed: make objects.")
    return Path(found.origin).parent / "random_urdfs"
