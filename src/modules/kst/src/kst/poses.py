"""Poses as 4x4 matrices [m] and KUKA's angles: R = Rz(a) Ry(b) Rx(c) [rad]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

RIGID_TOLERANCE = 1e-6


def check_pose(T: ArrayLike) -> np.ndarray:
    """Returns T as a read-only float array, shape (4, 4).

    Raises:
        ValueError: not finite, not rigid (scale, shear, mirror), or the last row is not 0 0 0 1.
    """
    T = read_only(T)
    if T.shape != (4, 4) or not np.all(np.isfinite(T)):
        raise ValueError(f"a pose needs 4 x 4 finite numbers, not {T.tolist()}")
    R = T[:3, :3]
    if np.abs(R @ R.T - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(R) < 0.0:
        raise ValueError(f"the rotation {R.tolist()} of the pose is not orthonormal and right-handed")
    if not np.array_equal(T[3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError(f"the last row of a pose is 0 0 0 1, not {T[3].tolist()}")
    return T


def read_only(values: ArrayLike) -> np.ndarray:
    """Returns a read-only float copy of `values`, for frozen records."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def rotation_from_zyx(a: float, b: float, c: float) -> np.ndarray:
    """Returns Rz(a) Ry(b) Rx(c), shape (3, 3)."""
    (sa, sb, sc), (ca, cb, cc) = np.sin((a, b, c)), np.cos((a, b, c))
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ]
    )


def zyx_from_rotation(R: np.ndarray) -> tuple[float, float, float]:
    """Returns a, b, c with R = Rz(a) Ry(b) Rx(c), b in [-pi/2, pi/2]; at |b| = pi/2 one of the many solutions."""
    a = math.atan2(R[1, 0], R[0, 0])
    b = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    sa, ca = math.sin(a), math.cos(a)
    c = math.atan2(sa * R[0, 2] - ca * R[1, 2], ca * R[1, 1] - sa * R[0, 1])
    return a + 0.0, b + 0.0, c + 0.0  # no -0.0
