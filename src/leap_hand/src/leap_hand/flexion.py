"""How far the fingers are closed and spread, as four angles seen from the palm centre.

The angles are between vectors of the Leap frame (metres), so they depend neither on where the hand is nor on its
attitude nor on its side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from common.poses import read_only

MIN_LENGTH_M = 1e-3
"""A joint nearer to the palm centre than this has no direction from there."""


@dataclass(frozen=True)
class HandPoints:
    """The points of a hand that count here; each in the Leap frame, shape (3,) [m].

    Attributes:
        palm: palm centre.
        normal: unit vector out of the palm (no unit).
        index_tip: tip of the index finger.
        middle_tip: tip of the middle finger.
        thumb_tip: tip of the thumb.
        index_bone: centre of the index finger's intermediate bone.
        middle_bone: centre of the middle finger's intermediate bone.
    """

    palm: np.ndarray
    normal: np.ndarray
    index_tip: np.ndarray
    middle_tip: np.ndarray
    thumb_tip: np.ndarray
    index_bone: np.ndarray
    middle_bone: np.ndarray

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, read_only(getattr(self, field.name)))


def flexion(points: HandPoints) -> np.ndarray:
    """Returns alpha, beta, gamma, delta, shape (4,) [rad].

    alpha, beta, gamma: between the palm normal and the vectors to the tips of index, middle finger and thumb; about
    90 deg for a flat hand, less for a closed one. delta: between the vectors to the intermediate bones of index and
    middle finger.

    Raises:
        ValueError: a number is not finite, or a point lies in the palm centre.
    """
    return np.array(
        [
            angle_between(points.normal, points.index_tip - points.palm),
            angle_between(points.normal, points.middle_tip - points.palm),
            angle_between(points.normal, points.thumb_tip - points.palm),
            angle_between(points.index_bone - points.palm, points.middle_bone - points.palm),
        ]
    )


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle [rad], 0 to pi, between the vectors a and b, shape (3,); exact near 0 and pi too.

    Raises:
        ValueError: a vector is not finite or shorter than MIN_LENGTH_M.
    """
    for v in (a, b):
        length = np.linalg.norm(v)
        if not np.isfinite(length) or length < MIN_LENGTH_M:
            raise ValueError(f"the vector {np.asarray(v).tolist()} has no direction")
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(np.dot(a, b)))
