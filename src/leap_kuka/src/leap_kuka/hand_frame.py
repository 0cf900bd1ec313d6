"""The hand as a frame: x along the hand, z out of the palm, y completes; the same for left and right hands.

Everything is written in the Leap frame: x to the user's right, y up, z towards the user; metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from common.poses import read_only
from common.rotations import UNIT_TOLERANCE, unit

ORTHOGONAL_TOLERANCE = 0.01
"""How far the cosine between direction and normal may be off zero; the tracker prints them to six digits."""

MAX_DISTANCE_M = 2.0
"""Farther from the Leap no hand can be; the tracker's documented reach is 0.6 m."""


@dataclass(frozen=True)
class HandSample:
    """One hand of one tracking frame.

    Attributes:
        id: the tracker's number of this hand.
        is_left: whether it is a left hand.
        position: palm centre, shape (3,) [m].
        direction: unit vector from the palm to the fingers, shape (3,).
        normal: unit vector out of the palm, shape (3,).
        confidence: 0 to 1.
    """

    id: int
    is_left: bool
    position: np.ndarray
    direction: np.ndarray
    normal: np.ndarray
    confidence: float

    def __post_init__(self) -> None:
        for name in ("position", "direction", "normal"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def name(self) -> str:
        """The hand for people, such as "right hand 12"."""
        return f"{'left' if self.is_left else 'right'} hand {self.id}"


def sample_fault(sample: HandSample) -> str | None:
    """Returns why the sample cannot be the pose of a hand, or None."""
    numbers = np.concatenate([sample.position, sample.direction, sample.normal, [sample.confidence]])
    if not np.all(np.isfinite(numbers)):
        return f"not all numbers of the hand are finite: {numbers.tolist()}"
    if np.linalg.norm(sample.position) > MAX_DISTANCE_M:
        return f"the palm is {np.linalg.norm(sample.position):.1f} m away from the Leap"
    for name in ("direction", "normal"):
        norm = np.linalg.norm(getattr(sample, name))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            return f"the {name} of the hand has length {norm:.4g} instead of 1"
    if abs(sample.direction @ sample.normal) > ORTHOGONAL_TOLERANCE:
        angle = math.degrees(math.acos(np.clip(sample.direction @ sample.normal, -1.0, 1.0)))
        return f"direction and normal of the hand stand at {angle:.1f} deg instead of 90"
    if not 0.0 <= sample.confidence <= 1.0:
        return f"the confidence is {sample.confidence:g} and not within 0 and 1"
    return None


def hand_rotation(direction: ArrayLike, normal: ArrayLike) -> np.ndarray:
    """Returns R_leap_hand, shape (3, 3), with x along `direction` and z as near to `normal` as that allows.

    Args:
        direction: from the palm to the fingers, shape (3,), any length.
        normal: out of the palm, shape (3,), any length.

    Raises:
        ValueError: a vector has no direction, or both have the same.
    """
    x = unit(direction)
    normal = unit(normal)
    z = unit(normal - (normal @ x) * x)
    return np.column_stack([x, np.cross(z, x), z])
