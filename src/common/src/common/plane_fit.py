"""A plane through most pixels of a depth image, in inverse depth. A plane is a vector a, shape (3,) [1/m], with a . X =
1 for its points X; it equals n / D with the unit normal n and the distance D. Along a pixel's ray (x, y, 1) the inverse
depth is a . ray, which is linear in a."""

from __future__ import annotations

import numpy as np

GATE_SD = 3.0


def fit_plane(rays: np.ndarray, w: np.ndarray, noise: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Returns the plane through most pixels, shape (3,) [1/m], the weights of the pixels, shape (n,), and the standard
    deviation of the inliers' errors [1/m]. The pixels have `rays`, shape (n, 3), and inverse depths w, shape (n,)
    [1/m], with the maximum standard deviation `noise` [1/m]. The start is the best of many planes through three pixels
    (MSAC: RANSAC with errors that are clipped at the gate), followed by iteratively reweighted least squares. The
    triples are the same in every call."""
    # number of pixel triples: with half of the pixels outliers, one triple without any is among them
    hypotheses = 120
    # larger errors, in standard deviations, have no weight (biweight, 95 % efficient for normal errors)
    tukey_sd = 4.685
    rounds = 5
    mad_to_sd = 1.4826
    triples = np.random.default_rng(0).integers(0, len(w), (hypotheses, 3))
    corners = rays[triples]
    sound = np.abs(np.linalg.det(corners)) > 1e-12
    planes = np.linalg.solve(corners[sound], w[triples[sound]][..., None])[..., 0]
    errors = planes.astype(np.float32) @ rays.T.astype(np.float32)
    errors -= w.astype(np.float32)
    gate = np.float32((GATE_SD * noise) ** 2)
    squares = np.minimum(np.square(errors, out=errors), gate, out=errors)
    weights = (squares[np.argmin(squares.sum(axis=1))] < gate).astype(float)
    for _ in range(rounds):
        a = np.linalg.solve((rays * weights[:, None]).T @ rays, (rays * weights[:, None]).T @ w)
        error = np.subtract(w, rays @ a)
        sd = np.clip(mad_to_sd * np.median(np.abs(error[weights > 0.0])), 1e-3 * noise, noise)
        weights = np.clip(1.0 - (error / (tukey_sd * sd)) ** 2, 0.0, None) ** 2
    inside = weights > 0.0
    return a, weights, float(np.sqrt(np.mean(error[inside] ** 2)))
