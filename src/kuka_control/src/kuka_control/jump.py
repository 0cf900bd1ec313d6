"""Whether the stream of joint targets made a jump that must not be servoed to (behaviour: the control loops)."""

from __future__ import annotations

import numpy as np

TOLERANCE_RAD = float(np.radians(2.0))
"""What a joint may differ by and still be servoed to from rest, and what a jump is beyond the joint speed limits."""

LOST_S = 0.1
"""Targets further apart in time than this belong to a signal that was lost and found again [s]."""

CYCLE_S = 0.01
"""The time that the arm is given for the way across such a gap: one cycle of the stream [s]."""


def is_jump(q_before: np.ndarray, q_now: np.ndarray, dt: float, joint_speeds: np.ndarray) -> bool:
    """Returns whether some joint moves more than 2 deg beyond what its speed limit allows in one cycle.

    Args:
        q_before: the target before, shape (7,) [rad].
        q_now: the new target, shape (7,) [rad].
        dt: time between the two [s].
        joint_speeds: limits, shape (7,) [rad/s].
    """
    cycle = max(dt, 0.0) if dt <= LOST_S else CYCLE_S
    return bool(np.any(np.abs(q_now - q_before) > TOLERANCE_RAD + joint_speeds * cycle))
