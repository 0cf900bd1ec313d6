"""The grasps of an image that lift most probably, or that an operator prefers among those that lift, each with an
approach of its own: what the network of lifts chooses, without near duplicates."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from common.poses import read_only
from grasping.network.maps import Peak
from grasping.pipeline.projection import CameraGrasp, seen_by
from grasping.poses.chooser import ImageMaps, ScoredPoses, choose
from grasping.poses.hypotheses import MIN_OPENING_M, pixels_of, turned, upright
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.preferred import GraspUncertainty, offer, preferred, uncertainty
from grasping.poses.taste import PoseTaste

ALIKE_RAD = 0.5  # grasps near each other and turned by less are one


class LiftGrasp(NamedTuple):
    """A grasp with the probability that it lifts as its quality."""

    peak: Peak  # in the network's image
    grasp: CameraGrasp  # before the view's camera
    rank: float  # by which grasps are ordered, 0 to 1: the quality less what the tilt costs, or the favourite's is 1
    uncertainty: GraspUncertainty | None  # None without a taste


def lift_grasps(
    network: LiftNetwork,
    of: ImageMaps,
    before: tuple[np.ndarray, np.ndarray],
    count: int,
    distance: int,
    threshold: float | None,
    widest: float,
    max_tilt: float,
    taste: PoseTaste | None = None,
    own: tuple[np.ndarray, np.ndarray] | None = None,
) -> Iterator[LiftGrasp]:
    """Returns at most `count` grasps above a probability, one after another, best first; None as `threshold`: the best
    alone. Those within `distance` rows and columns differ in direction. `before`: poses, shape (k, 4, 4) [m], and
    openings, shape (k,) [m], of those in the image before, which stay while they are good; `widest`: opening of the
    hand [m]; `max_tilt` [rad]; `own`: poses and openings of GG-CNN's grasps, without a taste.
    """
    again = None
    if len(before[0]):
        T = before[0].copy()
        T[:, :3, :3] = upright(T[:, :3, :3], of.frame, max_tilt)  # the table was maybe seen otherwise then
        again = of.hypotheses(T, before[1])
    about = None
    if taste is None:
        of_ggcnn = None if own is None else of.hypotheses(own[0], np.clip(own[1], MIN_OPENING_M, widest))
        scored = choose(network, of, widest, max_tilt, again, of_ggcnn)
    else:
        offered = offer(network, of, widest, max_tilt, again)
        scored = preferred(network, of, offered, taste, widest, max_tilt, again)
        about = functools.partial(uncertainty, taste, offered.options)
    return itertools.islice(_distinct(of, scored, distance, threshold, about), 1 if threshold is None else count)


def _distinct(
    of: ImageMaps,
    scored: ScoredPoses,
    distance: int,
    threshold: float | None,
    about: Callable[[np.ndarray], GraspUncertainty] | None,
) -> Iterator[LiftGrasp]:
    T, opening, probability = scored.of.T, scored.of.opening, scored.probability
    rows, columns, _ = pixels_of(T[:, :3, 3], of.image, of.camera)
    left = probability > (-1.0 if threshold is None else threshold)
    while left.any():
        i = int(np.argmax(left))
        angle, pixel, wide = seen_by(of.camera, T[i], float(opening[i]))
        width = wide * len(of.image.depth) / of.image.crop.side
        peak = Peak(int(rows[i]), int(columns[i]), float(probability[i]), angle, width)
        grasp = CameraGrasp(read_only(T[i]), angle, float(opening[i]), width, peak.quality, pixel)
        yield LiftGrasp(peak, grasp, float(scored.rank[i]), None if about is None else about(T[i]))
        near = np.maximum(np.abs(rows - rows[i]), np.abs(columns - columns[i])) <= distance
        left &= ~(near & (turned(T[:, :3, :3], T[i, :3, :3]) < ALIKE_RAD))
