"""The tags of the marker panel as triangles: exact edges, no texture that a renderer could blur or mirror.

The tag's frame has its origin in the middle, x to the right and y up for who looks at it, z towards him. Lengths in m.
"""

from __future__ import annotations

import numpy as np

CODES = (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822)
"""The first ids of the family tag36h11: 36 bits row by row from the top left, most significant first, 1 = white."""
CELLS = 8
"""Cells along the edge of the black square, its border of one cell on each side included."""
THICKNESS = 0.0002

_CORNERS = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
_FACES = np.array(
    [
        (0, 3, 1),
        (0, 2, 3),
        (4, 5, 7),
        (4, 7, 6),
        (0, 1, 5),
        (0, 5, 4),
        (2, 7, 3),
        (2, 6, 7),
        (0, 4, 6),
        (0, 6, 2),
        (1, 3, 7),
        (1, 7, 5),
    ]
)


def black_cells(tag: int) -> np.ndarray:
    """Returns which cells of a tag are black, shape (8, 8), first row on top."""
    bits = [CODES[tag] >> (35 - i) & 1 for i in range(36)]
    cells = np.ones((CELLS, CELLS), dtype=bool)
    cells[1:7, 1:7] = ~np.array(bits, dtype=bool).reshape(6, 6)
    return cells


def tag_mesh(tag: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices, shape (n, 3) [m], and triangles, shape (m, 3), of the black cells as thin plates on z = 0.

    Args:
        tag: id, an index of CODES.
        size: edge of the black square [m].
    """
    cell = size / CELLS
    vertices, triangles = [], []
    for row, cells in enumerate(black_cells(tag)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2):
            low = np.array([start * cell - size / 2.0, size / 2.0 - (row + 1) * cell, 0.0])
            high = np.array([end * cell - size / 2.0, size / 2.0 - row * cell, THICKNESS])
            triangles.append(_FACES + 8 * len(vertices))
            vertices.append(low + _CORNERS * (high - low))
    return np.concatenate(vertices), np.concatenate(triangles)
