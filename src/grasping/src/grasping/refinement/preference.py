"""What an operator would take among the candidates that are likely to be lifted, and how sure that is.

A candidate whose lift is less probable than `SAFE` and than GG-CNN's best one less `MOST_LOST` is never chosen; nor is
one with another line, unless it is as probable but for `MOST_LOST`. The operator's turn and tilt are taken over as far
as that lets them; the constant miss is not copied. The favourite is the candidate with most of the expected choices
near it; without episodes it is GG-CNN's best, unchanged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from common.rotations import rotation_about
from grasping.refinement import lifts, taste
from grasping.refinement.candidates import LIFTS, Candidates
from grasping.refinement.lifts import LiftModel
from grasping.refinement.taste import SHARPNESS, Taste

SAFE = 0.93  # probability of a lift that is enough
MOST_LOST = 0.01  # where GGCNN's best candidate has less, another one may have as much less [probability]
STYLES = (1.0, 0.75, 0.5, 0.25, 0.0)  # fractions of the operator's turn and tilt that are tried


class Preference(NamedTuple):
    """What is known of an operator and of a hand."""

    taste: Taste
    lifts: LiftModel | None  # None: nothing is known of lifts, and nothing constrains the taste


class Preferred(NamedTuple):
    """A candidate as the operator would take it."""

    candidate: int  # its number
    quality: float  # of GGCNN's best candidate for the favourite, less for others
    style: float  # fraction of the operator's turn and tilt
    tilt: np.ndarray  # of the approach about x and y of the level frame, shape (2,) [rad]
    turn: float  # from the candidate's line [rad]
    wider: float  # than needed [m]
    probability: float  # that the operator takes this candidate or one near it
    covariance: np.ndarray  # of what is taken there about this candidate, along x and y, shape (2, 2) [m^2]


def preferences(of: Candidates, known: Preference) -> list[Preferred]:
    """Returns the allowed candidates, the favourite first."""
    # Chosen on training families and drawn operators.
    near_m = 0.015  # standard deviations within which candidates are about the same choice
    near_rad = 0.2
    if not of.peaks:
        return []
    worth = taste.worths(known.taste.weights, of)
    choice = taste.softmax(worth)
    off = of.points[None, :, :2] - of.points[:, None, :2]
    angle = taste.half_turn(of.angles[None] - of.angles[:, None])
    near = np.exp(-0.5 * ((off**2).sum(axis=-1) / near_m**2 + (angle / near_rad) ** 2)) * choice
    mass = near.sum(axis=1)
    # Before any episode no choice is expected but the best quality's.
    appeal = np.log(mass) if known.taste.weights.any() else worth
    allowed, style = constrained(of, known)
    order = [int(i) for i in np.argsort(-appeal, kind="stable") if allowed[i]]
    tilts, turns = styles(of, known.taste)
    wider = taste.wider(known.taste.hand, of.heights)
    best, top = float(of.quality[0]), float(appeal[order[0]])
    return [
        Preferred(
            i,
            max(0.0, best + float(appeal[i] - top) / SHARPNESS),
            float(style[i]),
            style[i] * tilts[i],
            float(style[i] * turns[i]),
            float(wider[i]),
            float(min(1.0, mass[i])),
            (off[i] * near[i][:, None]).T @ off[i] / mass[i],
        )
        for i in order
    ]


def styles(of: Candidates, known: Taste) -> tuple[np.ndarray, np.ndarray]:
    """Returns the operator's tilts, shape (n, 2) [rad], and turns without the constant miss, shape (n,) [rad]."""
    hand = known.hand
    return taste.tilts(hand, of.heights, of.slopes), taste.turns(hand, of.heights) - hand.line[0]


def constrained(of: Candidates, known: Preference) -> tuple[np.ndarray, np.ndarray]:
    """Returns which candidates are allowed, shape (n,), bool, and the largest fraction of the operator's turn and tilt
    with which each of them is, shape (n,). GGCNN's best candidate as GGCNN has it always is.
    """
    n = len(of.peaks)
    tilts, turns = styles(of, known.taste)
    if known.lifts is None:
        return np.ones(n, bool), np.ones(n)
    plain = lifts.probabilities(known.lifts, of, 0.0 * tilts, 0.0 * turns)
    other = of.lifts[:, LIFTS.index("other line")] > 0.0
    least = np.where(other, plain[0] - MOST_LOST, min(plain[0] - MOST_LOST, SAFE))
    allowed, style = plain >= least, np.zeros(n)
    for fraction in sorted(STYLES):
        holds = lifts.probabilities(known.lifts, of, fraction * tilts, fraction * turns) >= least
        allowed |= holds
        style[holds] = fraction
    return allowed, style


def rotation(of: Candidates, one: Preferred) -> np.ndarray:
    """Returns the orientation of a preferred grasp before the camera, shape (3, 3)."""
    line = rotation_about(2, -(of.angles[one.candidate] + one.turn))
    if not one.tilt.any() and one.turn == 0.0:
        return line
    return of.frame.R @ pin.exp3(np.append(one.tilt, 0.0)) @ line
