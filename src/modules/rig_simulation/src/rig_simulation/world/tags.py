"""The tags of the marker board as triangles: exact edges, without a texture that a renderer could blur or mirror.

The tag's frame has its origin in the middle, x to the right, y up and z out of the face. Lengths in m.
"""

from __future__ import annotations

import numpy as np

from common.tag36h11 import CELLS, black_cells

THICKNESS = 0.0002

_CORNERS = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
_FACES = np.array(list("031023457476015054273267046062137175"), dtype=int).reshape(-1, 3)


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
