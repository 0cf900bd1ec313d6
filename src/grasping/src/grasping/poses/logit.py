"""A conditional logit and a linear regression with normal priors, of choices that are known with a probability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def softmax(values: np.ndarray) -> np.ndarray:
    """Returns probabilities, shape of `values`."""
    mass = np.exp(values - values.max())
    return mass / mass.sum()


def log_posterior(
    weights: np.ndarray, seen: Sequence[np.ndarray], offsets: Sequence[np.ndarray], meant: Sequence[np.ndarray]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Returns the logarithm of the weights' posterior, but for a constant, its gradient and its negative Hessian. Of
    each choice: `seen`: features of its n candidates, shape (n, d); `offsets`: their worth without weights, shape (n,);
    `meant`: how probably each is the choice, shape (n,), sum at most 1.
    """
    value, gradient, hessian = -0.5 * float(weights @ weights), -weights, np.eye(len(weights))
    for x, base, target in zip(seen, offsets, meant):
        worth = base + x @ weights
        top = worth.max()
        logs = worth - top - np.log(np.exp(worth - top).sum())
        p, mass = np.exp(logs), target.sum()
        mean = p @ x
        value += float(target @ logs)
        gradient = gradient + target @ x - mass * mean
        hessian = hessian + mass * ((x * p[:, None]).T @ x - np.outer(mean, mean))
    return value, gradient, hessian


def maximised(
    weights: np.ndarray, seen: Sequence[np.ndarray], offsets: Sequence[np.ndarray], meant: Sequence[np.ndarray]
) -> np.ndarray:
    """Returns the weights of the highest posterior: Newton's method, which the concave function lets converge."""
    steps = 25  # Newton's of a maximisation, at most
    close = 1e-6
    value, gradient, hessian = log_posterior(weights, seen, offsets, meant)
    for _ in range(steps):
        step = np.linalg.solve(hessian, gradient)
        size = 1.0
        while True:
            trial = log_posterior(weights + size * step, seen, offsets, meant)
            if trial[0] >= value or size < close:
                break
            size *= 0.5
        weights = weights + size * step
        gained = trial[0] - value
        value, gradient, hessian = trial
        if gained < close:
            break
    return weights


def ridge(x: np.ndarray, y: np.ndarray, mass: np.ndarray, spread: float, sd: Sequence[float]) -> np.ndarray:
    """Returns the most probable coefficients of a weighted regression, shape (d,); `spread`: of the residuals; `sd`: of
    the coefficients before.
    """
    precision = (x * mass[:, None]).T @ x / spread**2 + np.diag(1.0 / np.square(sd))
    return np.linalg.solve(precision, x.T @ (mass * y) / spread**2)
