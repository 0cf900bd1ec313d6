"""The grasps of an image that an operator would take, among those that are likely to lift.

A grasp that lifts with less than `SAFE` and with less than the safest one less `MOST_LOST` is never taken. So the
operator's taste costs few lifts, however wrong it is; the constant miss across the vertical is not copied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from grasping.poses.chooser import ImageMaps, ScoredPoses, choose
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import MAX_TILT_RAD, Hypotheses, said_of, upright, varied
from grasping.poses.lift_network import LiftNetwork, lift_logits
from grasping.poses.taste import Options, PoseTaste, options, poses, styled, worths
from grasping.refinement.taste import half_turn, softmax

SAFE = 0.97  # probability of a lift that is enough
MOST_LOST = 0.01  # where the safest grasp has less, another one may have as much less [probability]


class Offer(NamedTuple):
    """What an image offers to any operator."""

    safest: ScoredPoses
    options: Options


def offer(network: LiftNetwork, of: ImageMaps, most_open: float, max_tilt: float = MAX_TILT_RAD) -> Offer:
    return Offer(choose(network, of, most_open, max_tilt), options(network, of, most_open))


def preferred(
    network: LiftNetwork,
    of: ImageMaps,
    offered: Offer,
    taste: PoseTaste,
    most_open: float,
    max_tilt: float = MAX_TILT_RAD,
) -> ScoredPoses:
    """Returns the allowed grasps of an image, the favourite first, with the probability that each one lifts; the safest
    ones where no grasp is allowed or no episode was shown."""
    best, each, scale = 32, 16, 0.5  # options that are looked at, and grasps near each one's
    safest, given = offered
    if not len(safest.probability) or not len(given.base) or not taste.weights.any():
        return safest
    frame = of.frame()
    appeal = expected(taste, given)
    top = np.argsort(-appeal, kind="stable")[:best]
    wanted = wanted_poses(taste, given, of, most_open, max_tilt)
    part = wanted.part(top)
    T, opening = varied(part, each, np.random.default_rng(0), most_open, frame, max_tilt, scale)
    near = Hypotheses(T, opening, said_of(T, opening, of.maps, of.certainty, of.image, of.camera, frame))
    away = 0.5 * distances(np.repeat(part.T, each, axis=0), T, taste) ** 2
    tried = Hypotheses(*(np.concatenate(pair) for pair in zip(part, near)))
    score = np.concatenate([appeal[top], np.repeat(appeal[top], each) - away])
    lifts = 1.0 / (1.0 + np.exp(-lift_logits(network, features(tried, of.image, of.camera, frame))))
    allowed = lifts >= min(SAFE, safest.probability[0] - MOST_LOST)
    order = np.argsort(-score, kind="stable")
    order = order[allowed[order]]
    if not len(order):
        return safest
    return ScoredPoses(tried.part(order), lifts[order])


def expected(taste: PoseTaste, given: Options) -> np.ndarray:
    """Returns the logarithm of the operator's choices that are expected at or near each option, shape (n,)."""
    near_m, near_rad = 0.015, 0.2  # standard deviations within which options are about the same choice
    of, choice = given.of, softmax(worths(taste.weights, given))
    off = of.points[None, :, :2] - of.points[:, None, :2]
    angle = half_turn(of.angles[None] - of.angles[:, None])
    near = np.exp(-0.5 * ((off**2).sum(axis=-1) / near_m**2 + (angle / near_rad) ** 2))
    found: np.ndarray = np.log(near @ choice)
    return found


def wanted_poses(taste: PoseTaste, given: Options, of: ImageMaps, most_open: float, max_tilt: float) -> Hypotheses:
    """Returns the grasps that the operator would take at the options, without the constant miss."""
    tilt, turn, deep, wider = styled(taste.style, given.of)
    opening = np.clip(given.of.openings + wider, 0.01, most_open)
    found = poses(given.of, tilt, turn - taste.style.line[0], deep, opening, of)
    found.T[:, :3, :3] = upright(found.T[:, :3, :3], given.of.frame, max_tilt)
    return found


def distances(T: np.ndarray, other: np.ndarray, taste: PoseTaste) -> np.ndarray:
    """Returns how far poses are from others, shape (n,), in standard deviations of the operator's grasps."""
    spread, _, tilted, _ = taste.spreads
    off = np.linalg.norm(T[:, :3, 3] - other[:, :3, 3], axis=1) / spread
    cosine = 0.5 * (np.einsum("nij,nij->n", T[:, :3, :3], other[:, :3, :3]) - 1.0)
    found: np.ndarray = np.hypot(off, np.arccos(np.clip(cosine, -1.0, 1.0)) / tilted)
    return found
