"""The grasps of an image that lift most probably, each with an approach of its own: what the network of lifts chooses,
without near duplicates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.poses import read_only
from grasping.network.maps import Peak
from grasping.pipeline.projection import CameraGrasp, seen_by, turned
from grasping.poses.chooser import ImageMaps, choose
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import Hypotheses, pixels_of, said_of
from grasping.poses.lift_network import LiftNetwork, lift_logits

ALIKE_RAD = 0.5  # grasps near each other and turned by less are one
STAYS = 0.05  # probability by which a new grasp must lead one like it of the image before


class LiftGrasp(NamedTuple):
    """A grasp with the probability that it lifts as its quality."""

    peak: Peak  # in the network's image
    grasp: CameraGrasp  # before the view's camera


def lift_grasps(
    network: LiftNetwork,
    of: ImageMaps,
    before: tuple[np.ndarray, np.ndarray],
    count: int,
    distance: int,
    threshold: float | None,
    widest: float,
    max_tilt: float,
) -> list[LiftGrasp]:
    """Returns at most `count` grasps above a probability, best first; None as `threshold`: the best alone. Those within
    `distance` rows and columns differ in direction. `before`: poses, shape (k, 4, 4) [m], and openings, shape (k,) [m],
    of those in the image before, which stay while they are good; `widest`: opening of the hand [m]; `max_tilt` [rad].
    """
    scored, frame = choose(network, of, widest, max_tilt), of.frame()
    T, opening, probability = scored.of.T, scored.of.opening, scored.probability
    if len(before[0]):
        again = Hypotheses(*before, said_of(*before, of.maps, of.certainty, of.image, of.camera, frame))
        kept = 1.0 / (1.0 + np.exp(-lift_logits(network, features(again, of.image, of.camera, frame))))
        order = np.argsort(-np.concatenate([kept + STAYS, probability]), kind="stable")
        pairs = (again.T, T), (again.opening, opening), (kept, probability)
        T, opening, probability = (np.concatenate(pair)[order] for pair in pairs)
    rows, columns, _ = pixels_of(T[:, :3, 3], of.image, of.camera)
    left = probability > (-1.0 if threshold is None else threshold)
    found: list[LiftGrasp] = []
    while left.any() and len(found) < (1 if threshold is None else count):
        i = int(np.argmax(left))
        angle, pixel, wide = seen_by(of.camera, T[i], float(opening[i]))
        width = wide * len(of.image.depth) / of.image.crop.side
        peak = Peak(int(rows[i]), int(columns[i]), float(probability[i]), angle, width)
        grasp = CameraGrasp(read_only(T[i]), angle, float(opening[i]), width, peak.quality, pixel)
        found.append(LiftGrasp(peak, grasp))
        near = np.maximum(np.abs(rows - rows[i]), np.abs(columns - columns[i])) <= distance
        left &= ~(near & (turned(T[:, :3, :3], T[i, :3, :3]) < ALIKE_RAD))
    return sorted(found, key=lambda one: -one.peak.quality)
