"""A conditional logit over the candidates of an image: which of them an operator takes, learned from choices.

A candidate's worth is its quality, times `SHARPNESS`, and what the operator likes about its features, with normal
priors about zero. An operator's grasp is a candidate, a constant miss and a tremor; expectation-maximisation takes each
candidate as far as it explains the grasp, and so tells taste from miss.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from grasping.refinement.candidates import LENGTH_M, TASTES, Candidates

Angles = TypeVar("Angles", float, np.ndarray)
SHARPNESS = 8.0  # worth by quality, before anything is learned
OTHER_LINE = 0.1  # fraction of the grasps whose line has nothing to do with the candidate's
SPREAD_M, SPREAD_RAD = 0.008, 0.15  # expected standard deviations of a grasp about its candidate, along each axis
TILT_RAD, OPENING_M = 0.12, 0.01  # likewise of its tilt, and of its opening
WEIGHT_SD = {  # prior standard deviations of the features' weights
    "quality": 1.0,
    "height": 1.0,
    "below top": 1.0,
    "opening": 1.3,
    "along": 1.2,
    "towards lighter end": 1.2,
    "aside": 0.8,
    "from middle": 2.4,
    "from bulk": 0.6,
    "thickness": 0.8,
    "across": 1.0,
    "right": 0.6,
    "towards operator": 1.2,
    "line cos": 1.0,
    "line sin": 1.0,
    "rim": 0.9,
    "certainty": 0.8,
    "against line": 1.0,
}
"""Fitted by empirical Bayes to 20 episodes each of eight randomly drawn simulated operators with ten training families;
the named operators and the held-out families had no part in it."""
SD = np.array([WEIGHT_SD[name] for name in TASTES])


class Choice(NamedTuple):
    """A grasp of an operator, in the level frame, and the candidates that there were."""

    candidates: Candidates
    place: np.ndarray  # shape (3,) [m]
    angle: float  # of the line through the fingers, anticlockwise in the image [rad]
    tilt: np.ndarray  # of the approach about x and y, as `dataset.labels` has it, shape (2,) [rad]
    opening: float  # of the hand [m]; NaN where it is not known


class HandStyle(NamedTuple):
    """How an operator's hand grasps what was chosen: coefficients of 1, the height [LENGTH_M] and, behind tilts, the
    surface's slope down by y and by x.
    """

    line: np.ndarray  # turn from the candidate's line, anticlockwise, shape (2,) [rad]; the first is the constant miss
    tilt_x: np.ndarray  # of the approach about x, shape (3,) [rad]
    tilt_y: np.ndarray  # about y, shape (3,) [rad]
    opening: np.ndarray  # wider than needed, shape (2,) [m]
    tilt_spread: float  # standard deviation of a tilt about that, along each axis [rad]
    opening_spread: float  # of the opening [m]


class Taste(NamedTuple):
    """What was learned of an operator."""

    weights: np.ndarray  # of the features, shape (len(TASTES),)
    miss: np.ndarray  # of the operator's grasps, constant, in the level frame, shape (3,) [m]
    spread: float  # standard deviation of the grasps about their candidates, along each axis [m]
    angle_spread: float  # of their angles [rad]
    hand: HandStyle


def nobody() -> Taste:
    """Returns the taste before any episode: quality alone."""
    hand = HandStyle(np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(2), TILT_RAD, OPENING_M)
    return Taste(np.zeros(len(TASTES)), np.zeros(3), SPREAD_M, SPREAD_RAD, hand)


def worths(weights: np.ndarray, of: Candidates) -> np.ndarray:
    """Returns the worth of each candidate, shape (n,) [nats]."""
    return SHARPNESS * of.quality + of.tastes @ weights


def softmax(values: np.ndarray) -> np.ndarray:
    """Returns probabilities, shape of `values`."""
    mass = np.exp(values - values.max())
    return mass / mass.sum()


def learned(choices: Sequence[Choice]) -> Taste:
    """Returns the taste that explains an operator's grasps best; none: that of nobody."""
    rounds = 6  # of expectation and maximisation
    taste = nobody()
    choices = [c for c in choices if len(c.candidates.peaks)]
    if not choices:
        return taste
    seen = [c.candidates.tastes * SD for c in choices]  # with weights of the prior N(0, 1)
    offsets = [SHARPNESS * c.candidates.quality for c in choices]
    for _ in range(rounds):
        meant = [explained(taste, c, softmax(worths(taste.weights, c.candidates))) for c in choices]
        weights = SD * maximised(taste.weights / SD, seen, offsets, meant)
        taste = _measured(taste._replace(weights=weights), choices, meant)
    return taste


def explained(taste: Taste, choice: Choice, probability: np.ndarray) -> np.ndarray:
    """Returns how probably each candidate was the one that the operator meant, shape (n,), sum at most 1."""
    outlier = 0.05  # fraction of the grasps that are taken at no candidate
    outlier_m3 = 0.1**3  # volume over which these are spread [m^3]
    of = choice.candidates
    off = choice.place - taste.miss - of.points
    near = np.exp(-0.5 * (off**2).sum(axis=1) / taste.spread**2) / (np.sqrt(2.0 * np.pi) * taste.spread) ** 3
    line = _line_density(taste, half_turn(choice.angle - of.angles - turns(taste.hand, of.heights)))
    mass = (1.0 - outlier) * probability * near * ((1.0 - OTHER_LINE) * line + OTHER_LINE / np.pi)
    return mass / (mass.sum() + outlier / outlier_m3 / np.pi)


def turns(hand: HandStyle, heights: np.ndarray) -> np.ndarray:
    """Returns the turn from the lines of candidates at these heights, shape (n,) [rad]."""
    return hand.line[0] + hand.line[1] * heights / LENGTH_M


def tilts(hand: HandStyle, heights: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Returns the tilts of the approach at candidates, about x and y, shape (n, 2) [rad]."""
    x, y = _tilt_basis(heights, slopes)
    return np.stack([x @ hand.tilt_x, y @ hand.tilt_y], axis=1)


def wider(hand: HandStyle, heights: np.ndarray) -> np.ndarray:
    """Returns how much wider than needed the hand opens at candidates, shape (n,) [m]."""
    return hand.opening[0] + hand.opening[1] * heights / LENGTH_M


def _tilt_basis(heights: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    one, h = np.ones_like(heights), heights / LENGTH_M
    return np.stack([one, h, slopes[:, 1]], axis=1), np.stack([one, h, slopes[:, 0]], axis=1)


def _line_density(taste: Taste, off: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * (off / taste.angle_spread) ** 2) / (np.sqrt(2.0 * np.pi) * taste.angle_spread)


def half_turn(angles: Angles) -> Angles:
    """Returns angles modulo pi in [-pi/2, pi/2): a grasp is the same after half a turn."""
    return (angles + 0.5 * np.pi) % np.pi - 0.5 * np.pi


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


def _measured(taste: Taste, choices: Sequence[Choice], meant: Sequence[np.ndarray]) -> Taste:
    """Returns the taste with the miss, the hand and their spreads of the grasps about what they were meant to be."""
    miss_m = 0.01  # prior standard deviation of a constant miss along each axis
    line_sd = (0.1, 0.1)  # prior standard deviations of `HandStyle`'s coefficients
    tilt_sd = (0.2, 0.1, 0.4)
    opening_sd = (0.01, 0.01)
    of = [c.candidates for c in choices]
    mass = np.concatenate(list(meant))
    total = float(mass.sum())
    heights, slopes = np.concatenate([c.heights for c in of]), np.concatenate([c.slopes for c in of])
    off = np.concatenate([c.place - c.candidates.points for c in choices])
    miss = (mass @ off) / (total + (taste.spread / miss_m) ** 2)
    squares = float(mass @ ((off - miss) ** 2).sum(axis=1)) / 3.0
    spread = _spread(SPREAD_M, squares, total)
    turned = np.concatenate([half_turn(c.angle - c.candidates.angles) for c in choices])
    expected = turns(taste.hand, heights)
    about = half_turn(turned - expected)
    # A line that has nothing to do with the candidate's says nothing about the hand.
    density = (1.0 - OTHER_LINE) * _line_density(taste, about)
    of_line = mass * density / (density + OTHER_LINE / np.pi)
    turn_basis = np.stack([np.ones_like(heights), heights / LENGTH_M], axis=1)
    line = ridge(turn_basis, expected + about, of_line, taste.angle_spread, line_sd)
    squares = float(of_line @ half_turn(turned - turn_basis @ line) ** 2)
    angle_spread = _spread(SPREAD_RAD, squares, float(of_line.sum()))
    hand = taste.hand
    tilt = np.concatenate([np.tile(c.tilt, (len(c.candidates.peaks), 1)) for c in choices])
    x, y = _tilt_basis(heights, slopes)
    tilt_x = ridge(x, tilt[:, 0], mass, hand.tilt_spread, tilt_sd)
    tilt_y = ridge(y, tilt[:, 1], mass, hand.tilt_spread, tilt_sd)
    squares = 0.5 * float(mass @ ((tilt[:, 0] - x @ tilt_x) ** 2 + (tilt[:, 1] - y @ tilt_y) ** 2))
    opened = np.concatenate([c.opening - c.candidates.openings for c in choices])
    known = np.where(np.isfinite(opened), mass, 0.0)
    opened = np.nan_to_num(opened)
    opening = ridge(turn_basis, opened, known, hand.opening_spread, opening_sd)
    opening_spread = _spread(OPENING_M, float(known @ (opened - turn_basis @ opening) ** 2), float(known.sum()))
    hand = HandStyle(line, tilt_x, tilt_y, opening, _spread(TILT_RAD, squares, total), opening_spread)
    return taste._replace(miss=miss, spread=spread, angle_spread=angle_spread, hand=hand)


def ridge(x: np.ndarray, y: np.ndarray, mass: np.ndarray, spread: float, sd: Sequence[float]) -> np.ndarray:
    """Returns the most probable coefficients of a weighted regression, shape (d,); `spread`: of the residuals; `sd`: of
    the coefficients before.
    """
    precision = (x * mass[:, None]).T @ x / spread**2 + np.diag(1.0 / np.square(sd))
    return np.linalg.solve(precision, x.T @ (mass * y) / spread**2)


def _spread(expected: float, squares: float, count: float) -> float:
    spread_count = 10.0  # so many grasps is this expectation worth
    return float(np.sqrt((spread_count * expected**2 + squares) / (spread_count + count)))
