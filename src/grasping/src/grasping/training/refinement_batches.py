"""Batches for the second network: examples turned and shifted at random, and their targets.

The constant offset is taken off first: it belongs to the picture's directions and must not turn with it. What is left
turns and shifts with the picture exactly, but for the resampling.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import torch

from grasping.refinement import SHRINK
from grasping.training.batches import GRASPABLE
from grasping.training.refinement_examples import SIDE, Example, Scene

SIGMA_PX = 2.5
"""Of the target about the person's pixel, 5 px of the network's picture."""
SHIFT_PX = 10.0
SCENE_SHARE = 0.2


class Targets(NamedTuple):
    """What the second network should say of n pictures.

    Attributes:
        place: about the person's pixel, sum 1, shape (n, SIDE, SIDE); zero in synthetic scenes.
        held: 1 where the person's grasp held, 0 where it failed, shape (n,).
        height: of the grasp above the table, along the optical axis, shape (n,) [m].
        angle: shape (n,) [rad].
        tilt: without the constant one, shape (n, 2) [rad].
        is_scene: 1 for a synthetic scene, shape (n,).
        graspable: 1 where a synthetic scene can be grasped, shape (n, SIDE, SIDE).
        grasp_angle: there, shape (n, SIDE, SIDE) [rad].
        grasp_width: likewise, in units of `WIDTH_SCALE_PX`.
    """

    place: torch.Tensor
    held: torch.Tensor
    height: torch.Tensor
    angle: torch.Tensor
    tilt: torch.Tensor
    is_scene: torch.Tensor
    graspable: torch.Tensor
    grasp_angle: torch.Tensor
    grasp_width: torch.Tensor


def random_batch(
    examples: list[Example], scenes: list[Scene], offset: np.ndarray, rng: np.random.Generator, count: int
) -> tuple[torch.Tensor, Targets]:
    """Returns `count` random examples, turned and shifted, as input, shape (n, 5, SIDE, SIDE), and targets.

    Args:
        examples: of the person.
        scenes: synthetic, a share of `SCENE_SHARE` if there are any.
        offset: x, y, tilt_x, tilt_y as `refinement.RefinementNetwork` keeps it, shape (4,).
        rng: source of all chance.
        count: pictures.
    """
    chosen = []
    for _ in range(count):
        pool = scenes if scenes and rng.random() < SCENE_SHARE else examples
        chosen.append(_moved(pool[rng.integers(len(pool))], offset, rng.uniform(-np.pi, np.pi), _shift(rng)))
    return _stacked(chosen)


def batch(examples: list[Example], offset: np.ndarray) -> tuple[torch.Tensor, Targets]:
    """Returns examples as they are, as input and targets."""
    return _stacked([_moved(e, offset, 0.0, (0.0, 0.0)) for e in examples])


def moved_maps(maps: np.ndarray, turn: float, shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Returns maps, shape (5, s, s), of the picture turned anticlockwise [rad] and shifted right and down [px], and the
    affine map of its pixels (column, row), shape (2, 3)."""
    side = maps.shape[-1]
    middle = 0.5 * (side - 1)
    forward = cv2.getRotationMatrix2D((middle, middle), np.degrees(turn), 1.0)
    forward[:, 2] += shift
    if turn == 0.0 and shift == (0.0, 0.0):
        return maps.astype(np.float32), forward
    warped = np.stack(
        [cv2.warpAffine(m.astype(np.float32), forward, (side, side), borderMode=cv2.BORDER_REPLICATE) for m in maps]
    )
    c, s = np.float32(np.cos(2.0 * turn)), np.float32(np.sin(2.0 * turn))
    warped[1], warped[2] = c * warped[1] - s * warped[2], s * warped[1] + c * warped[2]
    return warped, forward


def _shift(rng) -> tuple[float, float]:
    x, y = rng.uniform(-SHIFT_PX, SHIFT_PX, 2)
    return float(x), float(y)


def _moved(one: Example | Scene, offset: np.ndarray, turn: float, shift: tuple[float, float]) -> dict[str, np.ndarray]:
    """Returns maps and targets of one picture, turned and shifted."""
    maps, forward = moved_maps(one.maps, turn, shift)
    blank = np.zeros((SIDE, SIDE), np.float32)
    made = {"maps": maps, "place": blank, "held": 0.0, "height": 0.0, "angle": 0.0, "tilt": np.zeros(2)}
    made.update(is_scene=float(isinstance(one, Scene)), graspable=blank, grasp_angle=blank, grasp_width=blank)
    if isinstance(one, Scene):
        size = (SIDE, SIDE)
        near = [cv2.warpAffine(m, forward, size, flags=cv2.INTER_NEAREST) for m in one[1:]]
        made.update(graspable=(near[0] > GRASPABLE).astype(np.float32), grasp_angle=near[1] + turn, grasp_width=near[2])
        return made
    x, y = offset[:2] / (SHRINK * one.mean)
    column, row = forward @ np.array([one.column - x, one.row - y, 1.0])
    # The camera's y axis points down: anticlockwise in the picture is a negative turn about its z axis.
    c, s = np.cos(turn), np.sin(turn)
    tilt = np.array([[c, s], [-s, c]]) @ (one.tilt - offset[2:])
    made.update(place=place_target(row, column), held=float(one.held), height=one.height, tilt=tilt)
    made.update(angle=one.angle + turn)
    return made


def place_target(row: float, column: float) -> np.ndarray:
    """Returns a bell of sum 1 about a pixel, shape (SIDE, SIDE), zeros where it lies outside."""
    at = np.arange(SIDE)
    bells = [np.exp(-0.5 * ((at - c) / SIGMA_PX) ** 2) for c in (row, column)]
    bell = np.outer(*bells)
    return (bell / max(float(bell.sum()), 1.0)).astype(np.float32)


def _stacked(made: list[dict[str, np.ndarray]]) -> tuple[torch.Tensor, Targets]:
    tensors = {k: torch.from_numpy(np.stack([np.float32(m[k]) for m in made])) for k in made[0]}
    return tensors.pop("maps"), Targets(**tensors)
