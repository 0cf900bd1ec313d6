"""Whether the stream made a jump that must not be servoed to (behaviour: the control loops), and whose jump it was.

Joints may jump although the tool frame did not: the frame was out of reach for a while and comes back elsewhere, or it
passes a place where a joint is at the end of its range and the others have to make room.
"""

from __future__ import annotations

import numpy as np

from common.rotations import rotation_angle
from kuka_control.model.desired_frame import DesiredFrame

TOLERANCE_RAD = float(np.radians(2.0))
"""What a joint may differ by and still be servoed to from rest, and what a jump is beyond the joint speed limits."""

TOLERANCE_M = 0.017
"""What a jump of the frame is beyond the speed limits: what 2 deg of a joint make of it half a metre away [m]."""

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
    return bool(np.any(np.abs(q_now - q_before) > TOLERANCE_RAD + joint_speeds * _cycle(dt)))


class FrameSteps:
    """Watches the steps of the desired tool frame itself, also while the arm cannot follow it.

    Args:
        tool_speed: of a frame that moves on and does not jump [m/s].
        turn_speed: likewise [rad/s].

    Attributes:
        jumped: whether a step was a jump since the arm followed last.
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
        way = float(np.linalg.norm(frame.T_base_tool[:3, 3] - last.T_base_tool[:3, 3]))
        turn = rotation_angle(last.T_base_tool[:3, :3].T @ frame.T_base_tool[:3, :3])
        jump = way > TOLERANCE_M + self._tool_speed * cycle or turn > TOLERANCE_RAD + self._turn_speed * cycle
        self.jumped = self.jumped or jump

    def followed(self) -> None:
        """Tells that the arm follows the frame."""
        self.jumped = False


def _cycle(dt: float) -> float:
    """Returns the time that the arm is given for a way that took the stream `dt` [s]."""
    return max(dt, 0.0) if dt <= LOST_S else CYCLE_S
