"""How probably a candidate is lifted: a logistic regression on outcomes, by what is seen of it and the hand's style.

Features enter linearly, squared and by their products with the quality; a tilt and a turn away from the candidate's own
approach and line enter squared, the tilt apart along the line through the fingers and across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from grasping.refinement.candidates import LIFTS, Candidates

WEIGHT_SD = 0.2  # prior standard deviation of a weight of a feature of unit variance
STEPS = 30


class LiftModel(NamedTuple):
    """What was learned from outcomes."""

    middle: np.ndarray  # of the terms, shape (d,)
    scale: np.ndarray  # their standard deviations, shape (d,)
    weights: np.ndarray  # of the scaled terms, and at the end the constant, shape (d + 1,)


def terms(lifts: np.ndarray, angles: np.ndarray, tilts: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Returns what the weights belong to, shape (n, d). Of n grasps: `lifts`: features of candidates, shape
    (n, len(LIFTS)); `angles`: of their lines [rad]; `tilts`: about x and y, shape (n, 2) [rad]; `turns` [rad].
    """
    quality = lifts[:, [LIFTS.index("quality")]]
    c, s = np.cos(angles), -np.sin(angles)  # of the line, in the level frame
    about, across = tilts[:, 0] * c + tilts[:, 1] * s, tilts[:, 1] * c - tilts[:, 0] * s
    style = np.stack([about**2, across**2, np.abs(about), np.abs(across), turns**2, np.abs(turns)], axis=1)
    return np.concatenate([lifts, lifts**2, lifts * quality, style], axis=1)


def probabilities(model: LiftModel, of: Candidates, tilts: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Returns how probably each candidate is lifted with a tilt, shape (n, 2) [rad], and turn, shape (n,) [rad]."""
    return _logistic(_design(model, terms(of.lifts, of.angles, tilts, turns)) @ model.weights)


def learned(rows: np.ndarray, lifted: Sequence[bool] | np.ndarray, weight_sd: float = WEIGHT_SD) -> LiftModel:
    """Returns the model of the highest posterior; `rows`: terms of n grasps, shape (n, d); `lifted`: shape (n,)."""
    close = 1e-8
    middle, scale = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-6)
    y = np.asarray(lifted, float)
    model = LiftModel(middle, scale, np.zeros(rows.shape[1] + 1))
    x = _design(model, rows)
    precision = np.append(np.full(rows.shape[1], weight_sd**-2.0), 1e-3)
    w = model.weights
    for _ in range(STEPS):
        p = _logistic(x @ w)
        hessian = (x * (p * (1.0 - p))[:, None]).T @ x + np.diag(precision)
        step = np.linalg.solve(hessian, x.T @ (y - p) - precision * w)
        w = w + step / max(1.0, float(np.abs(step).max()))
        if np.abs(step).max() < close:
            break
    return model._replace(weights=w)


def _design(model: LiftModel, rows: np.ndarray) -> np.ndarray:
    return np.column_stack([(rows - model.middle) / model.scale, np.ones(len(rows))])


def _logistic(x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0)))
