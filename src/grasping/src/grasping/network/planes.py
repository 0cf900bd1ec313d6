"""The plane that most pixels of a depth image, or of a part of it, lie in.

A plane is a vector a, shape (3,) [1/m], with a . X = 1 for its points X: the unit vector along it points away from the
camera, its length is one over the distance. Along a pixel's ray (x, y, 1) the inverse depth is a . ray, linear in a,
and the noise of a structured-light camera is nearly constant there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

TRIPLES = 64
"""Of pixels, each a hypothesis: with a third of the pixels in the plane, one triple without an outlier is among them in
nine of ten images."""
GATE_SD = 3.0
ROUNDS = 3
FLAT = 1e-9
"""A smaller determinant is of three pixels in a row."""


class PlaneFound(NamedTuple):
    """A plane in an image."""

    a: np.ndarray  # shape (3,) [1/m]
    share: float  # of the pixels that lie in it

    @property
    def direction(self) -> np.ndarray:
        """Unit vector across the plane, away from the camera, shape (3,)."""
        return self.a / np.linalg.norm(self.a)

    @property
    def distance(self) -> float:
        """Of the plane from the camera [m]."""
        return float(1.0 / np.linalg.norm(self.a))


def best_plane(rays: np.ndarray, depth: np.ndarray, noise: float) -> PlaneFound | None:
    """Returns the plane that most pixels lie in, None when there are too few.

    The same pixels give the same plane: the triples are drawn from a generator with a fixed seed.

    Args:
        rays: of the pixels, shape (n, 3), with 1 as their third number.
        depth: shape (n,) [m], finite and positive.
        noise: standard deviation of the inverse depth [1/m].
    """
    if len(depth) < 3:
        return None
    inverse = 1.0 / np.asarray(depth, dtype=float)
    gate = GATE_SD * noise
    picks = np.random.default_rng(0).integers(0, len(depth), (TRIPLES, 3))
    picks = picks[np.abs(np.linalg.det(rays[picks])) > FLAT]
    if not len(picks):
        return None
    planes = np.linalg.solve(rays[picks], inverse[picks][..., None])[..., 0]
    cost = np.minimum(np.abs(planes @ rays.T - inverse), gate).sum(axis=1)
    a = planes[np.argmin(cost)]
    for _ in range(ROUNDS):
        inside = np.abs(rays @ a - inverse) < gate
        squares = rays[inside].T @ rays[inside]
        if np.linalg.det(squares) < FLAT:
            return None
        a = np.linalg.solve(squares, rays[inside].T @ inverse[inside])
    if not np.linalg.norm(a) > 0.0:
        return None
    return PlaneFound(a, float(np.mean(np.abs(rays @ a - inverse) < gate)))
