"""Height maps of boxes on a table, for the tests of labels."""

from __future__ import annotations

import numpy as np

from grasping.lab.synthetic.samples import CELL_M

TABLE_M = 0.7


def boxes_on_table(n, boxes):
    """Returns a height map, shape (n, n) [m], with boxes (x, y, half x, half y, height), x right and y down from the
    middle [m].
    """
    surface = np.full((n, n), TABLE_M)
    c = CELL_M * (np.arange(n) - 0.5 * (n - 1))
    x, y = np.meshgrid(c, c)
    for bx, by, hx, hy, height in boxes:
        inside = (np.abs(x - bx) < hx) & (np.abs(y - by) < hy)
        surface[inside] = np.minimum(surface[inside], TABLE_M - height)
    return surface
