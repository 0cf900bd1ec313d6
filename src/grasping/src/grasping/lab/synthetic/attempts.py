"""Attempts to train on: hypotheses of a scene's image, and those of a sampler that knows the shapes, each lifted once
with the arm's error and shaken. The parallel gripper lifts here; the rig's hand by way of `evaluation.lift_file`."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from common.poses import inverse, pose
from grasping.lab.evaluation import trials
from grasping.lab.evaluation.lifting import lift
from grasping.lab.synthetic.full_poses import PoseSampler
from grasping.lab.synthetic.pose_labels import meant
from grasping.lab.synthetic.samples import SPLITS, SceneView, view
from grasping.lab.synthetic.scene import HeapScene
from grasping.network.depth_image import NetworkImage, prepare
from grasping.network.networks import MapNetwork, infer
from grasping.poses.chooser import ImageMaps, search
from grasping.poses.gripper import Gripper
from grasping.poses.hypotheses import MAX_TILT_RAD, TURNS, Hypotheses, Turn, hypotheses, joined, varied
from grasping.poses.lift_network import LiftNetwork


class Attempts(NamedTuple):
    """k attempts in one scene, as the hand makes them."""

    scene: HeapScene
    image: NetworkImage  # of the scene
    tried: Hypotheses
    T_world_grasp: np.ndarray  # with the arm's error, shape (k, 4, 4) [m]
    friction: np.ndarray  # of the scene, shape (k,)
    target: np.ndarray  # number of the object that each is meant for, shape (k,)


def image_maps(seen: SceneView, network: MapNetwork) -> ImageMaps:
    """Returns the network's image of a scene and GGCNN's maps."""
    image = prepare(seen.observed, trials.CROP)
    return ImageMaps.of_output(image, trials.camera(), infer(network, image.input))


def attempts(
    split: str, number: int, network: MapNetwork, most: int, gripper: Gripper, lifts: LiftNetwork | None = None
) -> Attempts:
    """Returns at most `most` attempts in a scene: of GGCNN's best places, of any, and of those that the shapes offer,
    and of poses near all of these; with a network of lifts, of those that it believes in."""
    rng = np.random.default_rng([66, SPLITS[split].number, number])
    seen = view(split, number)
    of = image_maps(seen, network)
    tried = _drawn(rng, seen, of, most, gripper) if lifts is None else _believed(rng, of, most, lifts, gripper)
    T_world_camera = pose(seen.camera.R, seen.camera.position)
    missed, frictions, targets = [], [], []
    for T in tried.T:
        miss = trials.miss(rng, trials.USUAL)
        targets.append(meant(split, seen.scene, T_world_camera @ T))
        frictions.append(float(rng.uniform(*trials.FRICTION)))
        missed.append(T_world_camera @ T @ miss)
    at = np.array(missed).reshape(-1, 4, 4), np.array(frictions), np.array(targets, int)
    return Attempts(seen.scene, of.image, tried, *at)


def lifted(of: Attempts, gripper: Gripper) -> list[str]:
    """Returns what comes of each attempt with a parallel gripper, of `pose_labels.REASONS`."""
    each = zip(of.T_world_grasp, of.tried.opening, of.friction, of.target)
    return [
        lift(of.scene, T, opening, gripper, friction, int(target), shake=True).reason
        for T, opening, friction, target in each
    ]


def _believed(rng: np.random.Generator, of: ImageMaps, most: int, lifts: LiftNetwork, gripper: Gripper) -> Hypotheses:
    """Returns grasps that a network of lifts ranks first, and some behind these: what training on others' grasps
    overrates."""
    mean_rank = 40.0
    found, probability = search(lifts, of, gripper.opening, MAX_TILT_RAD)
    ranked = found.part(np.argsort(-probability, kind="stable"))
    behind = rng.exponential(mean_rank, most - 1).astype(int)
    return ranked.part(np.unique([0, *np.minimum(behind, len(ranked.T) - 1)])) if len(ranked.T) else ranked


def _drawn(rng: np.random.Generator, seen: SceneView, of: ImageMaps, most: int, gripper: Gripper) -> Hypotheses:
    tries, most_open, frame = 40, gripper.opening, of.frame
    at = of.maps, of.certainty, of.image, of.camera, frame, most_open
    usual = hypotheses(*at, TURNS)
    random = [Turn(*rng.uniform((-1.6, -0.6, -0.6, -0.01, -0.01), (1.6, 0.6, 0.6, 0.03, 0.02))) for _ in range(8)]
    other = hypotheses(*at, tuple(random))
    parts = []
    if len(usual.T):
        # Places stand in the order of GGCNN's quality.
        first = np.minimum(rng.exponential(6.0 * len(TURNS), most // 4).astype(int), len(usual.T) - 1)
        parts += [usual.part(first), other.part(rng.integers(len(other.T), size=most // 4))]
    sampler = PoseSampler(seen.scene, gripper)
    T_camera_world = inverse(pose(seen.camera.R, seen.camera.position))
    exact = []
    for target in rng.permutation(len(seen.scene.objects)):
        exact += list(itertools.islice(sampler.free(rng, int(target), tries, MAX_TILT_RAD), 3))
    if exact:
        T = np.array([T_camera_world @ one.T_world_grasp for one in exact[: most // 4]])
        opening = np.array([one.opening for one in exact[: most // 4]])
        parts.append(of.hypotheses(T, opening))
    found = joined(*parts) if parts else usual
    if len(found.T):
        near = varied(found.part(rng.integers(len(found.T), size=most - len(found.T))), 1, rng, most_open, frame)
        found = joined(found, of.hypotheses(*near))
    return found
