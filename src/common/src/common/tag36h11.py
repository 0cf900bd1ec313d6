"""The patterns of the first tags of the family tag36h11, for what draws them; detectors have tables of their own."""

from __future__ import annotations

import numpy as np

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822)
"""Ids 0 to 4: 36 bits row by row from the top left, most significant first, 1 = white."""
CELLS = 8  # along the edge of the black square, its border of one cell on each side included


def black_cells(tag: int) -> np.ndarray:
    """Returns which cells of the tag with that id are black, shape (8, 8), first row on top."""
    bits = np.array([CODES[tag] >> (35 - i) & 1 for i in range(36)])
    return np.pad(bits.reshape(6, 6) == 0, 1, constant_values=True)
