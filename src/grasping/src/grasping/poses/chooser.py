"""Chooses grasps of an image: scores all hypotheses, and those near the best ones; tilted ones only where no grasp from
straight above is sure, since of a thousand that are tilted some are overrated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from grasping.network.depth_image import NetworkImage
from grasping.network.maps import Maps, Smoothing, smoothed
from grasping.poses.candidates import LevelFrame, image_rays, level_frame
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import (
    ABOVE_RAD,
    LEVEL_TURNS,
    MAX_TILT_RAD,
    TURNS,
    Hypotheses,
    hypotheses,
    joined,
    said_of,
    varied,
)
from grasping.poses.lift_network import LiftNetwork, lift_logits

SMOOTHING = Smoothing(quality=2.0)
"""Of the maps: a wider blur would take the grasps on slender parts for bad."""
SAFE = 0.97  # probability of a lift that is enough
TILT_COST = 0.1  # probability by which a tilted grasp must lead one from straight above, by the radian
JUDGED, BESIDE = 32, 8  # grasps that lead, and those near each of them with which it is judged
STAYS = 0.05  # rank by which a new grasp must lead one of the image before


NONE = Hypotheses(np.zeros((0, 4, 4)), np.zeros(0), np.zeros((0, 3), np.float32))


class ScoredPoses(NamedTuple):
    """Grasps, the best first."""

    of: Hypotheses
    probability: np.ndarray  # of a lift, shape (n,)
    rank: np.ndarray  # by which they are ordered, but those of the image before come earlier, 0 to 1, shape (n,)


@dataclass(frozen=True, eq=False)
class ImageMaps:
    """An image and what GGCNN says of it."""

    image: NetworkImage
    camera: CameraModel
    maps: Maps  # smoothed
    certainty: np.ndarray  # length of GGCNN's (cos, sin), shape of the maps

    @classmethod
    def of_output(cls, image: NetworkImage, camera: CameraModel, output: np.ndarray) -> ImageMaps:
        """`output`: of GGCNN, shape (4, h, w)."""
        return cls(image, camera, smoothed(output, image.valid, SMOOTHING), np.hypot(output[1], output[2]))

    @cached_property
    def frame(self) -> LevelFrame:
        return level_frame(self.image, image_rays(self.image, self.camera))

    def hypotheses(self, T: np.ndarray, opening: np.ndarray) -> Hypotheses:
        """Returns grasps with poses, shape (n, 4, 4) [m], and openings, shape (n,) [m]."""
        return Hypotheses(T, opening, said_of(T, opening, self.maps, self.certainty, self.image, self.camera))


def choose(
    network: LiftNetwork,
    of: ImageMaps,
    most_open: float,
    max_tilt: float = MAX_TILT_RAD,
    before: Hypotheses | None = None,
    own: Hypotheses | None = None,
) -> ScoredPoses:
    """Returns the grasps of an image, the best first, and the probability that each one lifts: those from straight
    above, and where none of them lifts with `SAFE` those tilted by up to `max_tilt` [rad], too; `most_open`: what the
    hand opens at most [m]; `before`: what was chosen in the image before; `own`: GGCNN's grasps; those that the
    network trusts stand alone beside these, in their order. Empty where nothing stands on the table."""
    found, probability = trusted(network, of, own)
    of_ggcnn = len(probability)
    if not of_ggcnn:
        found, probability = search(network, of, most_open, min(ABOVE_RAD, max_tilt))
        if not len(probability):
            return ScoredPoses(found, probability, probability)
        if probability.max() < SAFE and max_tilt > ABOVE_RAD:
            tilted, lifts = search(network, of, most_open, max_tilt)
            found, probability = joined(found, tilted), np.concatenate([probability, lifts])
    lead = np.zeros(len(probability))
    if before is not None:
        found = joined(found, before)
        probability = np.concatenate([probability, lift_probabilities(network, of, before)])
        lead = np.append(lead, np.full(len(before.T), STAYS))
    cost = TILT_COST * np.maximum(tilts(found, of.frame) - ABOVE_RAD, 0.0)
    rank = np.maximum(probability - cost, 0.0)
    order = np.argsort(-(rank + lead), kind="stable")
    top, rest = order[:JUDGED], order[JUDGED:]
    probability[top] = with_those_near(network, of, found.part(top), probability[top], most_open, max_tilt)
    rank[top] = np.maximum(probability[top] - cost[top], 0.0)
    rank[rest] = np.minimum(rank[rest], rank[top].min())
    rank[:of_ggcnn] = rank[:of_ggcnn].max(initial=0.0)  # in GGCNN's order
    order = np.argsort(-(rank + lead), kind="stable")
    return ScoredPoses(found.part(order), probability[order], rank[order])


def trusted(network: LiftNetwork, of: ImageMaps, own: Hypotheses | None) -> tuple[Hypotheses, np.ndarray]:
    """Returns those of GGCNN's own grasps that lift with more than what the network trusts, in their order, and their
    probabilities: of a few grasps these are less often overrated than that of the best of a thousand."""
    if own is None:
        return NONE, np.zeros(0)
    lifts = lift_probabilities(network, of, own)
    return own.part(lifts > network.trusts), lifts[lifts > network.trusts]


def with_those_near(
    network: LiftNetwork, of: ImageMaps, best: Hypotheses, lifts: np.ndarray, most_open: float, max_tilt: float
) -> np.ndarray:
    """Returns the mean probability of each grasp's lift, whose own is `lifts`, and of those near it, shape (n,): the
    best of a thousand is overrated, and the arm misses by a little."""
    near = of.hypotheses(*varied(best, BESIDE, np.random.default_rng(0), most_open, of.frame, max_tilt))
    of_near = lift_probabilities(network, of, near).reshape(-1, BESIDE)
    found: np.ndarray = np.column_stack([of_near, lifts]).mean(axis=1)
    return found


def search(network: LiftNetwork, of: ImageMaps, most_open: float, max_tilt: float) -> tuple[Hypotheses, np.ndarray]:
    """Returns the hypotheses up to a tilt [rad] and those tried near the best ones, in no order, and the probability
    that each one lifts, shape (n,)."""
    elite, each, rounds = 16, 8, 2
    turns = TURNS if max_tilt > ABOVE_RAD else LEVEL_TURNS
    found = hypotheses(of.maps, of.certainty, of.image, of.camera, of.frame, most_open, turns, max_tilt)
    if not len(found.T):
        return found, np.zeros(0)
    probability = lift_probabilities(network, of, found)
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        best = found.part(np.argsort(-probability, kind="stable")[:elite])
        near = of.hypotheses(*varied(best, each, rng, most_open, of.frame, max_tilt))
        found = joined(found, near)
        probability = np.concatenate([probability, lift_probabilities(network, of, near)])
    return found, probability


def lift_probabilities(network: LiftNetwork, of: ImageMaps, tried: Hypotheses) -> np.ndarray:
    """Returns the probabilities of lifts, shape (n,)."""
    logits = lift_logits(network, features(tried, of.image, of.camera, of.frame, network.gripper)).astype(float)
    found: np.ndarray = 1.0 / (1.0 + np.exp(-logits))
    return found


def tilts(of: Hypotheses, frame: LevelFrame) -> np.ndarray:
    """Returns the angles between the approaches and straight down, shape (n,) [rad]."""
    return np.arccos(np.clip(of.T[:, :3, 2] @ frame.R[:, 2], -1.0, 1.0))
