"""The hand frame: x along the hand, z out of the palm, y completes it; the same for left and right hands.

All vectors are in the Leap frame: x to the user's right, y up, z towards the user; metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from common.rotations import UNIT_TOLERANCE, unit
from leap_motion.tracking import TrackedHand

ORTHOGONAL_TOLERANCE = 0.01
"""Largest cosine between direction and normal; the tracker prints them to six digits."""

MAX_DISTANCE_M = 2.0
"""Largest distance of a palm from the Leap; the tracker's documented range is 0.6 m."""


def hand_fault(hand: TrackedHand) -> str | None:
    """Returns why the numbers of a hand are invalid, or None."""
    numbers = np.concatenate([hand.palm, hand.direction, hand.normal, [hand.confidence]])
    if not np.all(np.isfinite(numbers)):
        return f"not all numbers of the hand are finite: {numbers.tolist()}"
    if np.linalg.norm(hand.palm) > MAX_DISTANCE_M:
        return f"the palm is {np.linalg.norm(hand.palm):.1f} m away from the Leap"
    for name in ("direction", "normal"):
        norm = np.linalg.norm(getattr(hand, name))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            return f"the {name} of the hand has length {norm:.4g} instead of 1"
    if abs(hand.direction @ hand.normal) > ORTHOGONAL_TOLERANCE:
        angle = math.degrees(math.acos(np.clip(hand.direction @ hand.normal, -1.0, 1.0)))
        return f"direction and normal of the hand enclose {angle:.1f} deg instead of 90"
    if not 0.0 <= hand.confidence <= 1.0:
        return f"the confidence is {hand.confidence:g} and not within 0 and 1"
    return None


def hand_rotation(direction: ArrayLike, normal: ArrayLike) -> np.ndarray:
    """Returns R_leap_hand, shape (3, 3), with x along `direction` and z closest to `normal`.

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
