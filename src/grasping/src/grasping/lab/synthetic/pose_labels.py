"""Labels of full poses: what the physics says of grasps that a sampler found, with the arm's error, through a shake."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.lift_trial import FAILURES, LIFTED
from grasping.lab.evaluation.lifting import lift, nearest_object
from grasping.lab.evaluation.trials import FRICTION, USUAL, miss
from grasping.lab.synthetic import surroundings
from grasping.lab.synthetic.full_poses import FullPose, PoseSampler
from grasping.lab.synthetic.samples import SPLITS
from grasping.lab.synthetic.scene import HeapScene
from grasping.poses.gripper import Gripper

REASONS = (LIFTED, *FAILURES)


class PoseLabels(NamedTuple):
    """k grasps of one object of a scene, each tried `draws` times with errors of the arm."""

    T: np.ndarray  # T_world_grasp, shape (k, 4, 4) [m]
    opening: np.ndarray  # shape (k,) [m]
    steep: np.ndarray  # as of `FullPose`, shape (k,) [rad]
    reason: np.ndarray  # number in `REASONS`, 0 for a lift, shape (k, draws)


class LabelledScene(NamedTuple):
    """The object that is to be lifted, and its grasps by the greatest tilt that they were sampled with."""

    target: int
    friction: float
    grasps: tuple[PoseLabels, ...]


def target_of(split: str, scene: HeapScene, rng: np.random.Generator) -> int:
    """Returns the number of the object that is to be lifted: the upper one of a stack, else any."""
    if SPLITS[split].surroundings == surroundings.STACK:
        return len(scene.objects) - 1
    return int(rng.integers(len(scene.objects)))


def meant(split: str, scene: HeapScene, T_world_grasp: np.ndarray) -> int:
    """Returns the number of the object that a grasp of a method is meant for: the upper one of a stack, else the
    nearest one."""
    if SPLITS[split].surroundings == surroundings.STACK:
        return len(scene.objects) - 1
    return nearest_object(scene, T_world_grasp[:3, 3])


def labelled_scene(
    split: str, number: int, scene: HeapScene, tilts: tuple[float, ...], most: int, draws: int, gripper: Gripper
) -> LabelledScene:
    """Returns the labels of at most `most` grasps for each of the greatest `tilts` [rad]; friction, target and errors
    depend on the scene's number alone."""
    tries = 2_500  # random lines through the object
    rng = np.random.default_rng([88, SPLITS[split].number, number])
    target, friction = target_of(split, scene, rng), float(rng.uniform(*FRICTION))
    errors = [miss(rng, USUAL) for _ in range(draws)]
    sampler = PoseSampler(scene, gripper)
    grasps = []
    for tilt in tilts:
        found = [one for one, _ in zip(sampler.free(rng, target, tries, tilt), range(most))]
        numbers = [
            [REASONS.index(_tried(scene, one, error, friction, target, gripper)) for error in errors] for one in found
        ]
        grasps.append(
            PoseLabels(
                np.array([one.T_world_grasp for one in found]).reshape(-1, 4, 4),
                np.array([one.opening for one in found]),
                np.array([one.steep for one in found]),
                np.array(numbers, dtype=np.uint8).reshape(-1, draws),
            )
        )
    return LabelledScene(target, friction, tuple(grasps))


def _tried(scene: HeapScene, of: FullPose, error: np.ndarray, friction: float, target: int, gripper: Gripper) -> str:
    return lift(scene, of.T_world_grasp @ error, of.opening, gripper, friction, target, shake=True).reason
