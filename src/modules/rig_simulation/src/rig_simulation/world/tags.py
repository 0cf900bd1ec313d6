"""The tags of the marker panel as triangles: exact edges, no texture that a renderer could blur or mirror.

The tag's frame has its origin in the middle, x to the right and y up for who looks at it, z towards him. Lengths in m.
"""

from __future__ import annotations

import numpy as np

from common.tag36h11 import CELLS, black_cells

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


def tag_mesh(tag: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices, shape (n, 3) [m], and triangles, shape (m, 3), of the black cells as thin plates on z = 0.

    Args:
        tag: id, an index of common.tag36h11.CODES.
        size: edge of the black square [m].
    """
    cell = size / CELLS
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    for row, cells in enumerate(black_cells(tag)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2):
            low = np.array([start * cell - size / 2.0, size / 2.0 - (row + 1) * cell, 0.0])
            high = np.array([end * cell - size / 2.0, size / 2.0 - row * cell, THICKNESS])
            triangles.append(_FACES + 8 * len(vertices))
            vertices.append(low + _CORNERS * (high - low))
    return np.concatenate(vertices), np.concatenate(triangles)
