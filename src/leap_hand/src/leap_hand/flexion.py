"""Flexion and spread of the operator's fingers, as four angles at the palm centre, and the robot hand's from them.
The angles are between vectors of one hand, so they depend neither on its pose nor on its side."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from leap_hand.numbers import MIN_LENGTH_M
from leap_motion.frames import FingerPoints


def flexion(palm: np.ndarray, normal: np.ndarray, fingers: FingerPoints) -> np.ndarray:
    """Returns alpha, beta, gamma, delta, shape (4,) [rad]: between the palm normal and the vectors from the palm, shape
    (3,) [m], to the tips of index, middle finger and thumb, about 90 deg for a flat hand, less for a closed one; delta:
    between those to the intermediate bones of index and middle finger. Raises ValueError: not finite, or a point in the
    palm centre."""
    tips = (fingers.index_tip, fingers.middle_tip, fingers.thumb_tip)
    spread = angle_between(fingers.index_bone - palm, fingers.middle_bone - palm)
    return np.array([*(angle_between(normal, tip - palm) for tip in tips), spread])


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle [rad], 0 to pi, between the vectors a and b, shape (3,); exact near 0 and pi too. Raises
    ValueError: a vector is not finite or shorter than MIN_LENGTH_M."""
    p, q = np.asarray(a, dtype=float).tolist(), np.asarray(b, dtype=float).tolist()
    for v in (p, q):
        if not MIN_LENGTH_M <= math.hypot(*v) < math.inf:
            raise ValueError(f"the vector {v} has no direction")
    (px, py, pz), (qx, qy, qz) = p, q
    sine = math.hypot(py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx)
    return math.atan2(sine, px * qx + py * qy + pz * qz)


def map_angles(angles: ArrayLike, human: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Returns the robot's angles, shape (n,) [rad], of those of the human hand: linear, clipped at open and closed.
    `human` and `robot` are the angles of the open and the closed hand, shape (n, 2) [rad]; the human's two differ."""
    closed = np.clip((angles - human[:, 0]) / (human[:, 1] - human[:, 0]), 0.0, 1.0)
    return (1.0 - closed) * robot[:, 0] + closed * robot[:, 1]
