"""The patterns of the tag families that the PyPI package `apriltag` knows, as bitmaps to print and to compare with."""

from __future__ import annotations

import apriltag
import numpy as np

CELLS = {"tag36h11": 6, "tag36h10": 6, "tag36artoolkit": 6, "tag25h9": 5, "tag25h7": 5, "tag16h5": 4}
"""Data cells along an edge of each family; a border of one black cell goes round them."""


def pattern(detector: apriltag.Detector, family: str, tag: int) -> np.ndarray:
    """Returns which cells of a tag are white, shape (n + 4, n + 4) with n data cells along an edge.

    The outermost ring is the white margin, the next the black border; the first row is the tag's top.

    Raises:
        ValueError: there is no such tag.
    """
    table = detector.libc.apriltag_family_create(family.encode("ascii")).contents
    if not 0 <= tag < table.ncodes:
        raise ValueError(f"the family {family} has the ids 0 to {table.ncodes - 1}, not {tag}")
    n = table.d
    bits = [table.codes[tag] >> (n * n - 1 - i) & 1 for i in range(n * n)]
    cells = np.ones((n + 4, n + 4), dtype=bool)
    cells[1:-1, 1:-1] = False
    cells[2:-2, 2:-2] = np.array(bits, dtype=bool).reshape(n, n)
    return cells
