"""Which cells of a tag are black, for every tag of every family that the detection library knows."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import apriltag
import numpy as np

from apriltag_ros.settings import FAMILIES


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    return apriltag.Detector().libc


@lru_cache(maxsize=None)
def black_cells(family: str, tag: int) -> np.ndarray:
    """Returns which cells of the black square of a tag are black, first row on top, shape (n, n).

    Args:
        family: one of FAMILIES.
        tag: id in the family.

    Raises:
        ValueError: the family has no such tag.
    """
    if family not in FAMILIES:
        raise ValueError(f"{family} is none of {', '.join(FAMILIES)}")
    table = _library().apriltag_family_create(family.encode()).contents
    if not 0 <= tag < table.ncodes:
        raise ValueError(f"the family {family} has the tags 0 to {table.ncodes - 1}, but no tag {tag}")
    edge, border, code = table.d, table.black_border, table.codes[tag]
    white = [code >> (edge * edge - 1 - i) & 1 for i in range(edge * edge)]
    black = np.pad(~np.array(white, dtype=bool).reshape(edge, edge), border, constant_values=True)
    black.flags.writeable = False
    return black
