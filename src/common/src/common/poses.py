"""Poses as 4x4 homogeneous matrices: `T_a_b` is the pose of b in a; lengths in metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from common.rotations import check_rotation


def pose(R: ArrayLike | None = None, p: ArrayLike | None = None) -> np.ndarray:
    """Returns the pose with rotation R, shape (3, 3), and position p, shape (3,) [m]; identity if omitted."""
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if p is not None:
        T[:3, 3] = p
    return T


def translation(x: float, y: float, z: float) -> np.ndarray:
    """Returns the pose without rotation at x, y, z [m]."""
    return pose(p=(x, y, z))


def inverse(T: np.ndarray) -> np.ndarray:
    """Returns the inverse of the rigid pose T, shape (4, 4)."""
    R = T[:3, :3].T
    return pose(R, -R @ T[:3, 3])


def check_pose(T: ArrayLike, tolerance: float = 1e-6) -> np.ndarray:
    """Returns T as a float array, shape (4, 4); raises ValueError if it is not finite, not rigid (scale, shear,
    reflection), or its last row is not 0 0 0 1."""
    T = np.asarray(T, dtype=float)
    if T.shape != (4, 4) or not all(map(math.isfinite, T.ravel().tolist())):
        raise ValueError(f"a pose needs 4 x 4 finite numbers, not {T.tolist()}")
    if T[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError(f"the last row of a pose is 0 0 0 1, not {T[3].tolist()}")
    check_rotation(T[:3, :3], tolerance)
    return T


def read_only(values: ArrayLike) -> np.ndarray:
    """Returns a float copy of `values` that cannot be written to, for frozen records."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
