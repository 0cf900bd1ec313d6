"""Smooth solids as functions, and their surfaces as triangles.

A solid is a function of points, shape (..., 3) [mm], to the distance from its surface, negative inside; a lower bound
of the distance is enough. Blended unions and cuts of a few plain solids give the rounded housings of the arm and of the
hand. The surface comes from the naive surface nets of Gibson (1998): one vertex in each grid cell that the surface
crosses, then drawn onto the surface and spread evenly. The only operations are the four of arithmetic and the square
root, so the same numbers come out everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable

import numpy as np
from numpy.typing import ArrayLike

Solid = Callable[[np.ndarray], np.ndarray]
SMOOTHING_ROUNDS = PROJECTION_ROUNDS = 4


@dataclass(frozen=True)
class Mesh:
    """A closed surface."""

    vertices: np.ndarray  # shape (n, 3) [mm]
    normals: np.ndarray  # outward unit normals at the vertices, shape (n, 3)
    triangles: np.ndarray  # indices, anticlockwise seen from outside, shape (m, 3)


def _length(v: np.ndarray) -> np.ndarray:
    return np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2 + v[..., 2] ** 2)


def rod(start: ArrayLike, end: ArrayLike, radius_start: float, radius_end: float) -> Solid:
    """A rod with round ends whose radius changes linearly from start to end."""
    start, axis = np.array(start, dtype=float), np.array(end, dtype=float) - np.array(start, dtype=float)

    def distance(p: np.ndarray) -> np.ndarray:
        q = p - start
        along = (q[..., 0] * axis[0] + q[..., 1] * axis[1] + q[..., 2] * axis[2]) / (axis**2).sum()
        t = np.clip(along, 0.0, 1.0)
        return _length(q - t[..., None] * axis) - (radius_start + t * (radius_end - radius_start))

    return distance


def drum(
    axis: int, low: float, high: float, radius: float, centre: tuple[float, float] = (0.0, 0.0), edge: float = 3.0
) -> Solid:
    """A cylinder along a coordinate axis from low to high, its edges rounded by the radius `edge`.

    `centre` holds the other two coordinates of the cylinder's axis, in the order x, y, z.
    """
    a, b = (i for i in range(3) if i != axis)

    def distance(p: np.ndarray) -> np.ndarray:
        radial = np.sqrt((p[..., a] - centre[0]) ** 2 + (p[..., b] - centre[1]) ** 2) - (radius - edge)
        axial = np.abs(p[..., axis] - (low + high) / 2.0) - ((high - low) / 2.0 - edge)
        outside = np.sqrt(np.maximum(radial, 0.0) ** 2 + np.maximum(axial, 0.0) ** 2)
        return outside + np.minimum(np.maximum(radial, axial), 0.0) - edge

    return distance


def block(low: ArrayLike, high: ArrayLike, edge: float = 3.0) -> Solid:
    """A box between two opposite corners, its edges rounded by the radius `edge`."""
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)

    def distance(p: np.ndarray) -> np.ndarray:
        q = np.abs(p - (low + high) / 2.0) - ((high - low) / 2.0 - edge)
        return _length(np.maximum(q, 0.0)) + np.minimum(q.max(axis=-1), 0.0) - edge

    return distance


def above(axis: int, level: float) -> Solid:
    """Everything beyond a plane across a coordinate axis."""
    return lambda p: level - p[..., axis]


def below(axis: int, level: float) -> Solid:
    """Everything before a plane across a coordinate axis."""
    return lambda p: p[..., axis] - level


def blend(width: float, *solids: Solid) -> Solid:
    """The union; inner corners are filled over about `width`."""

    def distance(p: np.ndarray) -> np.ndarray:
        result = solids[0](p)
        for solid in solids[1:]:
            other = solid(p)
            overlap = np.maximum(width - np.abs(result - other), 0.0)
            result = np.minimum(result, other) - overlap**2 / (4.0 * width)
        return result

    return distance


def common_part(width: float, *solids: Solid) -> Solid:
    """The intersection; outer corners are rounded over about `width`."""
    return _inverted(blend(width, *(_inverted(solid) for solid in solids)))


def cut(width: float, solid: Solid, *tools: Solid) -> Solid:
    """The solid without the tools; the new outer corners are rounded over about `width`."""
    return common_part(width, solid, *(_inverted(tool) for tool in tools))


def mirrored(axis: int, solid: Solid) -> Solid:
    """The mirror image across the plane through the origin."""
    sign = np.ones(3)
    sign[axis] = -1.0
    return lambda p: solid(p * sign)


def _inverted(solid: Solid) -> Solid:
    return lambda p: -solid(p)


def surface(solid: Solid, low: ArrayLike, high: ArrayLike, cell: float) -> Mesh:
    """Returns the surface of a solid that lies strictly inside the box from low to high [mm], else raises ValueError.

    `cell`: edge of the grid's cubes [mm], about the edge of the triangles.
    """
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    shape = np.ceil((high - low) / cell).astype(int) + 1
    grid = low + cell * np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    values = solid(grid)
    inside = values < 0.0
    border = np.ones(shape, dtype=bool)
    border[1:-1, 1:-1, 1:-1] = False
    if not inside.any() or inside[border].any():
        raise ValueError(f"the solid has to lie strictly inside the box from {low.tolist()} to {high.tolist()} mm")

    vertices, number = _cell_vertices(grid, values, inside)
    quads = _quads(inside, number)
    for _ in range(SMOOTHING_ROUNDS):
        vertices = _drawn_onto(solid, _spread(vertices, quads), cell)
    corners = vertices[quads]
    shorter = _length(corners[:, 0] - corners[:, 2]) <= _length(corners[:, 1] - corners[:, 3])
    first = np.where(shorter[:, None], quads[:, [0, 1, 2]], quads[:, [0, 1, 3]])
    second = np.where(shorter[:, None], quads[:, [0, 2, 3]], quads[:, [1, 2, 3]])
    return Mesh(vertices, _gradient(solid, vertices), np.concatenate([first, second]))


def _cell_vertices(grid: np.ndarray, values: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns one vertex per crossed cell, shape (n, 3), and the vertex number of each cell (-1: not crossed)."""
    cells = tuple(n - 1 for n in inside.shape)
    total, count = np.zeros((*cells, 3)), np.zeros(cells)
    for axis in range(3):
        start, end = _both_ends(axis)
        crossed = inside[start] != inside[end]
        step = np.where(crossed, values[start] - values[end], 1.0)
        t = np.where(crossed, values[start] / step, 0.0)[..., None]
        point = np.where(crossed[..., None], grid[start] + t * (grid[end] - grid[start]), 0.0)
        b, c = (i for i in range(3) if i != axis)
        for shift_b in (0, 1):
            for shift_c in (0, 1):
                corner = [slice(None)] * 3
                corner[b] = slice(shift_b, shift_b + cells[b])
                corner[c] = slice(shift_c, shift_c + cells[c])
                total += point[tuple(corner)]
                count += crossed[tuple(corner)]
    active = count > 0
    number = np.full(cells, -1)
    number[active] = np.arange(active.sum())
    return total[active] / count[active][:, None], number


def _quads(inside: np.ndarray, number: np.ndarray) -> np.ndarray:
    """Returns the vertex numbers of the quadrilateral around each crossed grid edge, shape (m, 4)."""
    quads = []
    for axis in range(3):
        start, end = _both_ends(axis)
        crossed = inside[start] != inside[end]
        index = np.argwhere(crossed)
        b, c = (axis + 1) % 3, (axis + 2) % 3
        ring = []
        for back in ((1, 1), (0, 1), (0, 0), (1, 0)):
            cell = index.copy()
            cell[:, [b, c]] -= back
            ring.append(number[tuple(cell.T)])
        quad = np.stack(ring, axis=1)
        leaves = inside[start][crossed]
        quads.append(np.where(leaves[:, None], quad, quad[:, ::-1]))
    return np.concatenate(quads)


def _both_ends(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    start, end = [slice(None)] * 3, [slice(None)] * 3
    start[axis], end[axis] = slice(None, -1), slice(1, None)
    return tuple(start), tuple(end)


def _spread(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Returns the vertices moved half-way to the mean of their neighbours."""
    total, count = np.zeros_like(vertices), np.zeros(len(vertices))
    for i in range(4):
        for j in ((i + 1) % 4, (i - 1) % 4):
            np.add.at(total, quads[:, i], vertices[quads[:, j]])
            np.add.at(count, quads[:, i], 1.0)
    return (vertices + total / count[:, None]) / 2.0


def _drawn_onto(solid: Solid, vertices: np.ndarray, cell: float) -> np.ndarray:
    """Returns the vertices moved along the solid's gradient onto its surface."""
    for _ in range(PROJECTION_ROUNDS):
        step = np.clip(solid(vertices), -cell / 2.0, cell / 2.0)
        vertices = vertices - step[:, None] * _gradient(solid, vertices)
    return vertices


def _gradient(solid: Solid, points: np.ndarray, h: float = 0.5) -> np.ndarray:
    """Returns the unit direction in which the distance grows, shape (n, 3)."""
    parts = []
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = h
        parts.append(solid(points + shift) - solid(points - shift))
    gradient = np.stack(parts, axis=-1)
    return gradient / np.maximum(_length(gradient), 1e-9)[..., None]
