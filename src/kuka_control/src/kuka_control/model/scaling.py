"""The scaling factor: how far the tool moves for a motion of the hand, from the workspace centre.

Positions in the base frame [m]; rotations are not scaled.
"""

from __future__ import annotations

import numpy as np

SCALING_MIN = 0.1
SCALING_MAX = 1.5
SCALING_DEFAULT = 1.0


def check_scaling_factor(factor: float) -> float:
    """Returns the factor, within its range.

    Raises:
        ValueError: the factor is not finite or outside `SCALING_MIN` to `SCALING_MAX`.
    """
    if not SCALING_MIN <= factor <= SCALING_MAX:
        raise ValueError(f"the scaling factor {factor:g} is outside {SCALING_MIN:g} to {SCALING_MAX:g}")
    return float(factor)


def scaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), moved towards the centre (factor < 1) or away from it (factor > 1)."""
    return centre + factor * (position - centre)


def unscaled(position: np.ndarray, centre: np.ndarray, factor: float) -> np.ndarray:
    """Returns the position, shape (3,), that `scaled` brings to the given one."""
    return centre + (position - centre) / factor
