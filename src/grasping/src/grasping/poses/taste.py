"""What an operator likes: which place and line of an image, and how the hand tilts, turns, goes in and opens there.

Places and lines are options. The worth of one is how likely it lifts from straight above and GGCNN's quality, times
constants, and what the operator likes about its features, with normal priors about zero. A shown grasp is an option,
the hand's style there, a constant miss across the vertical and a tremor; expectation-maximisation takes each option as
far as it explains the grasp, and so tells taste from miss. Swapping the fingers changes nothing anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from grasping.network.maps import half_turn
from grasping.poses.candidates import LENGTH_M, TASTES, Candidates, candidates
from grasping.poses.chooser import ImageMaps
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import MIN_OPENING_M, Hypotheses, level_rotation, rotations
from grasping.poses.lift_network import LiftNetwork, lift_logits
from grasping.poses.logit import maximised, ridge, softmax

QUALITY_WORTH, LIFT_WORTH = 8.0, 0.25  # of an option, before anything is learned
LARGEST_LOGIT = 4.0
WEIGHT_SD = {  # prior standard deviations of the weights of `TASTES`
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
SD = np.array([*(WEIGHT_SD[name] for name in TASTES), 0.5])
OTHER_LINE = 0.1  # fraction of the grasps whose line has nothing to do with the option's
SPREAD_M, SPREAD_RAD = 0.008, 0.15  # expected standard deviations of a grasp about its option, along each axis
TILT_RAD, OPENING_M = 0.12, 0.01  # likewise of its tilt, and of its opening


class Options(NamedTuple):
    """n places and lines of an image that a hand can take."""

    of: Candidates
    seen: np.ndarray  # what may be liked, shape (n, d)
    base: np.ndarray  # worth before anything is learned, shape (n,) [nats]


class Shown(NamedTuple):
    """A grasp of an operator, in the level frame, and the options that there were."""

    options: Options
    place: np.ndarray  # shape (3,) [m]
    angle: float  # of the line through the fingers, anticlockwise in the image [rad]
    tilt: np.ndarray  # of the approach about x and y, as `dataset.labels` has it, shape (2,) [rad]
    opening: float  # of the hand [m]; NaN where it is not known


class Style(NamedTuple):
    """How an operator's hand takes an option: coefficients of 1, the height [LENGTH_M] and, behind tilts, the surface's
    slope down by y and by x.
    """

    line: np.ndarray  # turn from the option's line, anticlockwise, shape (2,) [rad]; the first is the constant miss
    tilt_x: np.ndarray  # of the approach about x, shape (3,) [rad]
    tilt_y: np.ndarray  # about y, shape (3,) [rad]
    deep: np.ndarray  # further along the approach than the surface, shape (2,) [m]
    wider: np.ndarray  # than needed, shape (2,) [m]


class PoseTaste(NamedTuple):
    """What was learned of an operator."""

    weights: np.ndarray  # of what is seen, shape (d,)
    miss: np.ndarray  # of the operator's grasps, constant, along x and y of the level frame, shape (2,) [m]
    style: Style
    spreads: np.ndarray  # standard deviations along each axis: place [m], line [rad], tilt [rad], opening [m]


def nobody() -> PoseTaste:
    """Returns the taste before any episode."""
    style = Style(np.zeros(2), np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2))
    return PoseTaste(np.zeros(len(SD)), np.zeros(2), style, np.array([SPREAD_M, SPREAD_RAD, TILT_RAD, OPENING_M]))


def options(network: LiftNetwork, of: ImageMaps, most_open: float) -> Options:
    """Returns the options of an image; `most_open`: what the hand opens at most [m]."""
    found = candidates(of.maps, of.certainty, of.image, of.camera, of.frame)
    n = len(found.peaks)
    if not n:
        return Options(found, np.zeros((0, len(SD))), np.zeros(0))
    upright = poses(
        found, np.zeros((n, 2)), np.zeros(n), np.zeros(n), np.clip(found.openings, MIN_OPENING_M, most_open), of
    )
    logits = lift_logits(network, features(upright, of.image, of.camera, found.frame, network.gripper))
    logits = np.clip(logits, -LARGEST_LOGIT, LARGEST_LOGIT)
    seen = np.column_stack([found.tastes, logits / LARGEST_LOGIT])
    return Options(found, seen, QUALITY_WORTH * found.quality + LIFT_WORTH * logits)


def poses(
    found: Candidates, tilt: np.ndarray, turn: np.ndarray, deep: np.ndarray, opening: np.ndarray, of: ImageMaps
) -> Hypotheses:
    """Returns hypotheses at options with a tilt, shape (n, 2) [rad], a turn [rad], a depth and an opening [m]."""
    n, frame = len(tilt), found.frame
    zero = np.zeros(n)
    R = rotations(np.column_stack([tilt, zero])) @ level_rotation(-(found.angles + turn), zero, zero)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = frame.R @ R
    T[:, :3, 3] = (found.points + deep[:, None] * R[:, :, 2]) @ frame.R.T
    return of.hypotheses(T, opening)


def worths(weights: np.ndarray, of: Options) -> np.ndarray:
    """Returns the worth of each option, shape (n,) [nats]."""
    return of.base + of.seen @ weights


def learned(shown: Sequence[Shown]) -> PoseTaste:
    """Returns the taste that explains an operator's grasps best; none: that of nobody."""
    rounds = 6  # of expectation and maximisation
    taste = nobody()
    shown = [one for one in shown if len(one.options.base)]
    if not shown:
        return taste
    seen, base = [one.options.seen * SD for one in shown], [one.options.base for one in shown]
    for _ in range(rounds):
        meant = [explained(taste, one) for one in shown]
        weights = SD * maximised(taste.weights / SD, seen, base, meant)
        taste = _measured(taste._replace(weights=weights), shown, meant)
    return taste


def explained(taste: PoseTaste, shown: Shown) -> np.ndarray:
    """Returns how probably each option was the one that the operator meant, shape (n,), sum at most 1."""
    outlier = 0.05  # fraction of the grasps that are taken at no option
    outlier_m3 = 0.1**3  # volume over which these are spread [m^3]
    of, spread = shown.options.of, float(taste.spreads[0])
    tilt, turn, deep, _ = styled(taste.style, of)
    approach = rotations(np.column_stack([tilt, np.zeros(len(tilt))]))[:, :, 2]
    off = shown.place - np.append(taste.miss, 0.0) - of.points - deep[:, None] * approach
    near = np.exp(-0.5 * (off**2).sum(axis=1) / spread**2) / (np.sqrt(2.0 * np.pi) * spread) ** 3
    line = _line_density(taste, half_turn(shown.angle - of.angles - turn))
    mass = (1.0 - outlier) * softmax(worths(taste.weights, shown.options)) * near
    mass = mass * ((1.0 - OTHER_LINE) * line + OTHER_LINE / np.pi)
    return mass / (mass.sum() + outlier / outlier_m3 / np.pi)


def styled(style: Style, of: Candidates) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns tilt about x and y, shape (n, 2) [rad], turn [rad], depth [m] and how much wider than needed [m] of the
    hand at options."""
    by_height, x, y = _bases(of)
    tilt = np.stack([x @ style.tilt_x, y @ style.tilt_y], axis=1)
    return tilt, by_height @ style.line, by_height @ style.deep, by_height @ style.wider


def _bases(of: Candidates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    by_height = np.column_stack([np.ones(len(of.heights)), of.heights / LENGTH_M])
    return by_height, np.column_stack([by_height, of.slopes[:, 1]]), np.column_stack([by_height, of.slopes[:, 0]])


def _line_density(taste: PoseTaste, off: np.ndarray) -> np.ndarray:
    spread = float(taste.spreads[1])
    density: np.ndarray = np.exp(-0.5 * (off / spread) ** 2) / (np.sqrt(2.0 * np.pi) * spread)
    return density


def _measured(taste: PoseTaste, shown: Sequence[Shown], meant: Sequence[np.ndarray]) -> PoseTaste:
    """Returns the taste with the miss, the style and the spreads of the grasps about what they were meant to be."""
    miss_m = 0.01  # prior standard deviations: of a constant miss along each axis
    line_sd, tilt_sd, length_sd = (0.1, 0.1), (0.3, 0.15, 0.4), (0.01, 0.01)  # and of the style's coefficients
    of = [one.options.of for one in shown]
    mass = np.concatenate(list(meant))
    total = float(mass.sum())
    place, line, tilted, opened = taste.spreads
    by_height, x, y = (np.concatenate(parts) for parts in zip(*(_bases(one) for one in of)))

    def of_each(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([np.tile(v, (len(one.heights), 1)) for v, one in zip(values, of)])

    approach = of_each([rotations(np.append(one.tilt, 0.0)[None])[0, :, 2] for one in shown])
    off = np.concatenate([one.place - one.options.of.points for one in shown])
    depth = ((off - np.append(taste.miss, 0.0)) * approach).sum(axis=1)
    deep = ridge(by_height, depth, mass, place, length_sd)
    beside = off - (by_height @ deep)[:, None] * approach
    miss = (mass @ beside[:, :2]) / (total + (place / miss_m) ** 2)
    squares = float(mass @ ((beside - np.append(miss, 0.0)) ** 2).sum(axis=1)) / 3.0
    turned_by = np.concatenate([half_turn(one.angle - one.options.of.angles) for one in shown])
    expected = by_height @ taste.style.line
    about = half_turn(turned_by - expected)
    # A line that has nothing to do with the option's says nothing about the hand.
    density = (1.0 - OTHER_LINE) * _line_density(taste, about)
    of_line = mass * density / (density + OTHER_LINE / np.pi)
    turn = ridge(by_height, expected + about, of_line, line, line_sd)
    line_squares = float(of_line @ half_turn(turned_by - by_height @ turn) ** 2)
    tilt = of_each([one.tilt for one in shown])
    tilt_x, tilt_y = ridge(x, tilt[:, 0], mass, tilted, tilt_sd), ridge(y, tilt[:, 1], mass, tilted, tilt_sd)
    tilt_squares = 0.5 * float(mass @ ((tilt[:, 0] - x @ tilt_x) ** 2 + (tilt[:, 1] - y @ tilt_y) ** 2))
    more = np.concatenate([one.opening - one.options.of.openings for one in shown])
    known, more = np.where(np.isfinite(more), mass, 0.0), np.nan_to_num(more)
    wider = ridge(by_height, more, known, opened, length_sd)
    open_squares = float(known @ (more - by_height @ wider) ** 2)
    spreads = [
        _spread(SPREAD_M, squares, total),
        _spread(SPREAD_RAD, line_squares, float(of_line.sum())),
        _spread(TILT_RAD, tilt_squares, total),
        _spread(OPENING_M, open_squares, float(known.sum())),
    ]
    return taste._replace(miss=miss, style=Style(turn, tilt_x, tilt_y, deep, wider), spreads=np.array(spreads))


def _spread(expected: float, squares: float, count: float) -> float:
    spread_count = 10.0  # so many grasps is this expectation worth
    return float(np.sqrt((spread_count * expected**2 + squares) / (spread_count + count)))
