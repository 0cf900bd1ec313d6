"""From the angles of the human hand to those of the robot hand: linear, and clipped at open and closed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def map_angles(angles: ArrayLike, human: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Returns the robot's angles, shape (n,) [rad].

    Args:
        angles: of the human hand, shape (n,) [rad].
        human: of the open and the closed human hand, shape (n, 2) [rad]; the two differ.
        robot: of the open and the closed robot hand, shape (n, 2) [rad].
    """
    closed = np.clip((angles - human[:, 0]) / (human[:, 1] - human[:, 0]), 0.0, 1.0)
    return (1.0 - closed) * robot[:, 0] + closed * robot[:, 1]
