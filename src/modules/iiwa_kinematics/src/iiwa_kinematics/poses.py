"""Poses as 4 x 4 homogeneous matrices: `T_a_b` is the pose of b in a; lengths in metres."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def inverse_pose(T: np.ndarray) -> np.ndarray:
    """Returns the inverse of a rigid pose, shape (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def read_only(values: ArrayLike) -> np.ndarray:
    """Returns a float copy of `values` that cannot be written to, for frozen records."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
