"""Attempts to train on: hypotheses of a scene's image, and those of a sampler that knows the shapes, each lifted once
with the arm's error and shaken."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from common.poses import inverse, pose
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic.full_poses import PoseSampler
from grasping.lab.synthetic.pose_labels import REASONS, meant
from grasping.lab.synthetic.samples import GRIPPER, SPLITS, SceneView, view
from grasping.network import maps
from grasping.network.depth_image import prepare
from grasping.network.networks import MapNetwork, infer
from grasping.poses.chooser import ImageMaps, choose
from grasping.poses.hypotheses import MAX_TILT_RAD, TURNS, Hypotheses, Turn, hypotheses, said_of, varied
from grasping.poses.lift_network import LiftNetwork

SMOOTHING = maps.Smoothing(quality=2.0)


class Attempts(NamedTuple):
    """k attempts in one scene."""

    depth: np.ndarray  # the network's image, shape (300, 300), float32 [m]
    valid: np.ndarray  # where the camera had a reading, shape (300, 300), bool
    T: np.ndarray  # T_camera_grasp, shape (k, 4, 4) [m]
    opening: np.ndarray  # shape (k,) [m]
    seen: np.ndarray  # as `Hypotheses.seen`, shape (k, 3)
    reason: np.ndarray  # number in `pose_labels.REASONS`, 0 for a lift, shape (k,), uint8


def image_maps(seen: SceneView, network: MapNetwork) -> ImageMaps:
    """Returns the network's image of a scene and GGCNN's maps."""
    image = prepare(seen.observed, trials.CROP)
    output = infer(network, image.input)
    return ImageMaps(
        image, trials.camera(), maps.smoothed(output, image.valid, SMOOTHING), np.hypot(output[1], output[2])
    )


def attempts(split: str, number: int, network: MapNetwork, most: int, lifts: LiftNetwork | None = None) -> Attempts:
    """Returns at most `most` attempts in a scene: of GGCNN's best places, of any, and of those that the shapes offer,
    and of poses near all of these; with a network of lifts, of those that it believes in."""
    rng = np.random.default_rng([66, SPLITS[split].number, number])
    seen = view(split, number)
    of = image_maps(seen, network)
    tried = _drawn(rng, seen, of, most) if lifts is None else _believed(rng, of, most, lifts)
    T_world_camera = pose(seen.camera.R, seen.camera.position)
    reasons = []
    for T, opening in zip(tried.T, tried.opening):
        miss = trials.miss(rng, trials.USUAL)
        T_world_grasp = T_world_camera @ T
        target = meant(split, seen.scene, T_world_grasp)
        friction = float(rng.uniform(*trials.FRICTION))
        at = T_world_grasp @ miss, opening, GRIPPER, friction, target
        result = lift(seen.scene, *at, shake=True)
        reasons.append(REASONS.index(result.reason))
    return Attempts(of.image.depth, of.image.valid, *tried, np.array(reasons, np.uint8))


def _believed(rng: np.random.Generator, of: ImageMaps, most: int, lifts: LiftNetwork) -> Hypotheses:
    """Returns grasps that a network of lifts ranks first, and some behind these: what training on others' grasps
    overrates."""
    mean_rank = 40.0
    ranked = choose(lifts, of, GRIPPER.opening).of
    behind = rng.exponential(mean_rank, most - 1).astype(int)
    return ranked.part(np.unique([0, *np.minimum(behind, len(ranked.T) - 1)])) if len(ranked.T) else ranked


def _drawn(rng: np.random.Generator, seen: SceneView, of: ImageMaps, most: int) -> Hypotheses:
    tries, most_open, frame = 40, GRIPPER.opening, of.frame()
    at = of.maps, of.certainty, of.image, of.camera, frame, most_open
    usual = hypotheses(*at, TURNS)
    random = [Turn(*rng.uniform((-1.6, -0.6, -0.6, -0.01, -0.01), (1.6, 0.6, 0.6, 0.03, 0.02))) for _ in range(8)]
    other = hypotheses(*at, tuple(random))
    parts = []
    if len(usual.T):
        # Places stand in the order of GGCNN's quality.
        first = np.minimum(rng.exponential(6.0 * len(TURNS), most // 4).astype(int), len(usual.T) - 1)
        parts += [usual.part(first), other.part(rng.integers(len(other.T), size=most // 4))]
    sampler = PoseSampler(seen.scene, GRIPPER)
    T_camera_world = inverse(pose(seen.camera.R, seen.camera.position))
    exact = []
    for target in rng.permutation(len(seen.scene.objects)):
        exact += list(itertools.islice(sampler.free(rng, int(target), tries, MAX_TILT_RAD), 3))
    if exact:
        T = np.array([T_camera_world @ one.T_world_grasp for one in exact[: most // 4]])
        opening = np.array([one.opening for one in exact[: most // 4]])
        parts.append(Hypotheses(T, opening, said_of(T, opening, *at[:5])))
    found = Hypotheses(*(np.concatenate(part) for part in zip(*parts))) if parts else usual
    if len(found.T):
        T, opening = varied(found.part(rng.integers(len(found.T), size=most - len(found.T))), 1, rng, most_open, frame)
        near = Hypotheses(T, opening, said_of(T, opening, *at[:5]))
        found = Hypotheses(*(np.concatenate(pair) for pair in zip(found, near)))
    return found
