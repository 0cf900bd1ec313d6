"""The grasps of an image that an operator would take, among those that are likely to lift.

A grasp is worth the probability of its lift and, times `WORTH`, that of the operator's choice: few shown episodes leave
that one low everywhere, and then the safest grasp is taken. One that lifts with less than `SAFE` and with less than the
safest one less `MOST_LOST` never is. So the taste costs few lifts, however wrong it is; the constant miss across the
vertical is not copied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from grasping.network.maps import half_turn
from grasping.poses.chooser import SAFE, ImageMaps, ScoredPoses, choose, lift_probabilities
from grasping.poses.hypotheses import MAX_TILT_RAD, MIN_OPENING_M, Hypotheses, joined, turned, upright, varied
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.logit import softmax
from grasping.poses.taste import Options, PoseTaste, options, poses, styled, worths

MOST_LOST = 0.01  # where the safest grasp has less, another one may have as much less [probability]
WORTH = 0.1  # of the operator's choice, in lifts
KEPT = 0.02  # by which what a new grasp is worth must lead that of one of the image before [lifts]


class Offer(NamedTuple):
    """What an image offers to any operator."""

    safest: ScoredPoses
    options: Options


class GraspUncertainty(NamedTuple):
    """The distribution of the operator's grasp."""

    probability: float  # that the operator grasps here rather than elsewhere, 0 to 1; NaN where GGCNN sees no place
    pose_sd: np.ndarray  # along x, y, z [m] and about x, y, z [rad] of the grasp's own axes, shape (6,)
    opening_sd: float  # [m]


def offer(
    network: LiftNetwork,
    of: ImageMaps,
    most_open: float,
    max_tilt: float = MAX_TILT_RAD,
    before: Hypotheses | None = None,
) -> Offer:
    """Returns the offer of an image; arguments as of `choose`."""
    return Offer(choose(network, of, most_open, max_tilt, before), options(network, of, most_open))


def preferred(
    network: LiftNetwork,
    of: ImageMaps,
    offered: Offer,
    taste: PoseTaste,
    most_open: float,
    max_tilt: float = MAX_TILT_RAD,
    before: Hypotheses | None = None,
) -> ScoredPoses:
    """Returns the allowed grasps of an image, the favourite first, and behind them the safest ones, which stand alone
    where no grasp is allowed or no episode was shown. `before`: what was chosen in the image before."""
    best, each, scale = 32, 16, 0.5  # options that are looked at, and grasps near each one's
    safest, given = offered
    if not len(safest.probability) or not len(given.base) or not taste.weights.any():
        return safest
    appeal = expected(taste, given)
    top = np.argsort(-appeal, kind="stable")[:best]
    appeal = appeal[top]
    part = wanted_poses(taste, given, of, most_open, max_tilt).part(top)
    near = of.hypotheses(*varied(part, each, np.random.default_rng(0), most_open, of.frame, max_tilt, scale))
    away = distances(np.repeat(part.T, each, axis=0), near.T, taste)
    tried, score = joined(part, near), np.concatenate([appeal, np.repeat(appeal, each) - 0.5 * away**2])
    first = int(np.argmax(safest.rank))  # of the image; in front of it may be those of the image before
    others = safest.of.part(np.array([first]))
    others = others if before is None else joined(others, before)
    away = distances(others.T[:, None], part.T, taste)
    tried, score = joined(tried, others), np.append(score, (appeal - 0.5 * away**2).max(axis=1))
    lifts = lift_probabilities(network, of, tried)  # each alone, that of the safest, too
    worth = lifts + WORTH * np.exp(score)
    lead = np.zeros(len(worth))
    if before is not None:
        lead[-len(before.T) :] = KEPT
    allowed = lifts >= min(SAFE, lifts[-len(others.T)] - MOST_LOST)
    order = np.argsort(-(worth + lead), kind="stable")
    order = order[allowed[order]]
    if not len(order):
        return safest
    rank = np.exp((worth[order] - worth[order].max()) / WORTH)
    lifts, rank = np.append(lifts[order], safest.probability), np.append(rank, rank.min() * safest.rank)
    return ScoredPoses(joined(tried.part(order), safest.of), lifts, rank)


def expected(taste: PoseTaste, given: Options) -> np.ndarray:
    """Returns the logarithm of the operator's choices that are expected at or near each option, shape (n,)."""
    at = given.of.points, given.of.angles
    found: np.ndarray = np.log(_near(*at, *at) @ softmax(worths(taste.weights, given)))
    return found


def uncertainty(taste: PoseTaste, given: Options, T_camera_grasp: np.ndarray) -> GraspUncertainty:
    """Returns the distribution of the operator's grasp about one, shape (4, 4) [m]."""
    of, probability = given.of, np.nan
    if len(given.base):
        T = of.frame.R.T @ T_camera_grasp[:3]
        angles = of.angles + styled(taste.style, of)[1] - taste.style.line[0]
        near = _near(T[None, :, 3], np.arctan2(-T[1:2, 0], T[:1, 0]), of.points, angles)
        probability = min(1.0, float(near[0] @ softmax(worths(taste.weights, given))))
    place, line, tilt, opening = taste.spreads.tolist()
    return GraspUncertainty(probability, np.array([place, place, place, tilt, tilt, line]), opening)


def _near(points: np.ndarray, angles: np.ndarray, others: np.ndarray, their_angles: np.ndarray) -> np.ndarray:
    """Returns how much places and lines, n of them, are the same choice as m others, 0 to 1, shape (n, m)."""
    near_m, near_rad = 0.015, 0.2  # standard deviations within which they are about the same choice
    off = others[None, :, :2] - points[:, None, :2]
    angle = half_turn(their_angles[None] - angles[:, None])
    found: np.ndarray = np.exp(-0.5 * ((off**2).sum(axis=-1) / near_m**2 + (angle / near_rad) ** 2))
    return found


def wanted_poses(taste: PoseTaste, given: Options, of: ImageMaps, most_open: float, max_tilt: float) -> Hypotheses:
    """Returns the grasps that the operator would take at the options, without the constant miss."""
    tilt, turn, deep, wider = styled(taste.style, given.of)
    opening = np.clip(given.of.openings + wider, MIN_OPENING_M, most_open)
    found = poses(given.of, tilt, turn - taste.style.line[0], deep, opening, of)
    found.T[:, :3, :3] = upright(found.T[:, :3, :3], given.of.frame, max_tilt)
    return found


def distances(T: np.ndarray, other: np.ndarray, taste: PoseTaste) -> np.ndarray:
    """Returns how far poses are from others, shape (..., 4, 4), in standard deviations of the operator's grasps."""
    spread, _, tilted, _ = taste.spreads
    off = np.linalg.norm(T[..., :3, 3] - other[..., :3, 3], axis=-1) / spread
    found: np.ndarray = np.hypot(off, turned(T[..., :3, :3], other[..., :3, :3]) / tilted)
    return found
