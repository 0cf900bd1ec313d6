"""How far the ReFlex hand is open where it grips, by the angles of its fingers; and the other way round.

Index and middle stand opposite the thumb. The fingers are taken as straight, as they are until they touch something,
and the opening is measured where `config/tool_pose.yaml` has the grasp: 150 mm from the hand's base.
"""

from __future__ import annotations

import numpy as np

SWIVEL_M, KNUCKLE_M, THUMB_M = 0.0504, 0.01, 0.03
"""From the hand's base to the swivels of index and middle, from there to their knuckles, and from the base to the
thumb's knuckle, along the line on which they close (URDF of the hand)."""
DEPTH_M = 0.150 - 0.0816
"""From the knuckles down to the grasp."""
WIDEST_M = 0.15
"""Fingers further apart are open to let go or to wave, not to grasp something: that says nothing."""


def opening(angles: np.ndarray) -> float:
    """Returns the opening [m]; NaN where the fingers do not stand about something, or are not known.

    Args:
        angles: shape (4,) [rad]: index, middle, thumb (0 = open), spread.
    """
    index, middle, thumb, spread = (float(a) for a in angles)
    if not np.all(np.isfinite(angles)) or min(np.sin([index, middle, thumb])) <= 0.0:
        return float("nan")
    beside = KNUCKLE_M + DEPTH_M * 0.5 * (1.0 / np.tan(index) + 1.0 / np.tan(middle))
    found = SWIVEL_M + THUMB_M + np.cos(spread) * beside + DEPTH_M / np.tan(thumb)
    return float(found) if 0.0 < found < WIDEST_M else float("nan")


def angles(opening_m: float) -> np.ndarray:
    """Returns finger angles, shape (4,) [rad], that open the hand so far, all fingers alike."""
    finger = np.arctan2(2.0 * DEPTH_M, opening_m - SWIVEL_M - KNUCKLE_M - THUMB_M)
    return np.array([finger, finger, finger, 0.0])
