"""Detects jumps of the stream that the arm must not servo to, and whether the tool frame or only the joints jumped.

Joints may jump although the tool frame did not: the frame was out of reach for a while and returns elsewhere, or it
passes a position where a joint reaches the end of its range and the others have to compensate.
"""

from __future__ import annotations

import numpy as np

from common.rotations import rotation_angle
from kuka_control.model.desired_frame import DesiredFrame

TOLERANCE_RAD = float(np.radians(2.0))
"""Largest joint step that is servoed to from rest, and the tolerance on top of the joint speed limits [rad]."""

TOLERANCE_M = 0.017
"""Tolerance of the frame's step on top of the speed limits: 2 deg of a joint, half a metre away [m]."""

LOST_S = 0.1
"""After a longer gap than this the signal counts as lost and found again [s]."""

CYCLE_S = 0.01
"""Time in which the arm has to cross such a gap: one cycle of the stream [s]."""


def is_jump(q_before: np.ndarray, q_now: np.ndarray, dt: float, joint_speeds: np.ndarray) -> bool:
    """Returns whether some joint moves more than 2 deg beyond what its speed limit allows in one cycle.

    Args:
        q_before: the target before, shape (7,) [rad].
        q_now: the new target, shape (7,) [rad].
        dt: time between the two [s].
        joint_speeds: limits, shape (7,) [rad/s].
    """
    return bool(np.any(np.abs(q_now - q_before) > TOLERANCE_RAD + joint_speeds * _cycle(dt)))


class FrameSteps:
    """Watches the steps of the desired tool frame itself, also while the arm cannot follow it.

    A frame that is faster than `tool_speed` [m/s] or `turn_speed` [rad/s] jumps. `jumped` is true if it has done so
    since the arm last followed.
    """

    def __init__(self, tool_speed: float, turn_speed: float) -> None:
        self._tool_speed = tool_speed
        self._turn_speed = turn_speed
        self._last: DesiredFrame | None = None
        self.jumped = False

    def take(self, frame: DesiredFrame) -> None:
        """Takes a new frame in."""
        last, self._last = self._last, frame
        if last is None:
            return
        cycle = _cycle(frame.stamp - last.stamp)
        distance = float(np.linalg.norm(frame.T_base_tool[:3, 3] - last.T_base_tool[:3, 3]))
        turn = rotation_angle(last.T_base_tool[:3, :3].T @ frame.T_base_tool[:3, :3])
        jump = distance > TOLERANCE_M + self._tool_speed * cycle or turn > TOLERANCE_RAD + self._turn_speed * cycle
        self.jumped = self.jumped or jump

    def followed(self) -> None:
        """Reports that the arm follows the frame."""
        self.jumped = False


def _cycle(dt: float) -> float:
    """Returns the time in which the arm has to make a step that took the stream `dt` [s]."""
    return max(dt, 0.0) if dt <= LOST_S else CYCLE_S
