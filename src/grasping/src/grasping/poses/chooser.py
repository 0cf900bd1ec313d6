"""Chooses grasps of an image: scores all hypotheses, and those near the best ones."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from grasping.network.depth_image import NetworkImage
from grasping.network.maps import Maps
from grasping.poses.hand_view import features
from grasping.poses.hypotheses import MAX_TILT_RAD, TURNS, Hypotheses, hypotheses, said_of, varied
from grasping.poses.lift_network import LiftNetwork, lift_logits
from grasping.refinement.candidates import LevelFrame, image_rays, level_frame


class ScoredPoses(NamedTuple):
    """Grasps, the most likely lift first."""

    of: Hypotheses
    probability: np.ndarray  # of a lift, shape (n,)


class ImageMaps(NamedTuple):
    """An image and what GGCNN says of it."""

    image: NetworkImage
    camera: CameraModel
    maps: Maps  # smoothed
    certainty: np.ndarray  # length of GGCNN's (cos, sin), shape of the maps

    def frame(self) -> LevelFrame:
        return level_frame(self.image, image_rays(self.image, self.camera))


def choose(network: LiftNetwork, of: ImageMaps, most_open: float, max_tilt: float = MAX_TILT_RAD) -> ScoredPoses:
    """Returns the hypotheses of an image up to a tilt [rad], with the probability that each one lifts; `most_open`:
    what the hand opens at most [m]. Empty where nothing stands on the table."""
    elite, each, rounds = 16, 8, 2
    frame = of.frame()
    found = hypotheses(of.maps, of.certainty, of.image, of.camera, frame, most_open, TURNS, max_tilt)
    if not len(found.T):
        return ScoredPoses(found, np.zeros(0))
    logits = lift_logits(network, features(found, of.image, of.camera, frame))
    rng = np.random.default_rng(0)
    for _ in range(rounds):
        best = found.part(np.argsort(-logits, kind="stable")[:elite])
        T, opening = varied(best, each, rng, most_open, frame, max_tilt)
        seen = said_of(T, opening, of.maps, of.certainty, of.image, of.camera, frame)
        near = Hypotheses(T, opening, seen)
        found = Hypotheses(*(np.concatenate(pair) for pair in zip(found, near)))
        logits = np.concatenate([logits, lift_logits(network, features(near, of.image, of.camera, frame))])
    order = np.argsort(-logits, kind="stable")
    return ScoredPoses(found.part(order), 1.0 / (1.0 + np.exp(-logits[order])))


def tilts(of: Hypotheses, frame: LevelFrame) -> np.ndarray:
    """Returns the angles between the approaches and straight down, shape (n,) [rad]."""
    return np.arccos(np.clip(of.T[:, :3, 2] @ frame.R[:, 2], -1.0, 1.0))
