"""Servo goals within the speed limits: how far the goal may go towards its target in one cycle.

The goal goes straight towards the target in joint space, as fast as the slowest of the limits lets it. A target that
the limits allow becomes the goal at once, unchanged: then this step adds no lag. Accelerations are not looked at here.

Targets come at uneven times, in between the target stands still. So unused time is saved up to `SAVED_S`, and a target
that arrives late but moves slowly enough on average is not held back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.poses import read_only

SAVED_S = 0.02
"""The most time that a single goal may use up [s]; also what a stall of the loop cannot exceed."""


@dataclass(frozen=True)
class SpeedLimits:
    """Greatest speeds of the stream: of each joint, shape (7,) [rad/s], and of the tool point [m/s]."""

    joints: np.ndarray
    tool: float

    def scaled(self, share: float) -> SpeedLimits:
        """Returns these limits times `share`."""
        return SpeedLimits(self.joints * share, self.tool * share)


@dataclass(frozen=True)
class Limited:
    """A servo goal.

    Attributes:
        q: the goal, shape (7,) [rad].
        limited_by: "joint speed" or "tool speed", what held the goal back; None when it is the target itself.
    """

    q: np.ndarray
    limited_by: str | None


class MotionLimits:
    """Follows a target with limited speed.

    Args:
        limits: the speed limits.
        tool_position: position of the tool point [m], shape (3,), at joints q.
    """

    def __init__(self, limits: SpeedLimits, tool_position: Callable[[np.ndarray], np.ndarray]) -> None:
        self._limits = limits
        self._tool_position = tool_position
        self._goal = None
        self._saved = 0.0

    def reset(self, q: np.ndarray) -> None:
        """Starts from the joints q, at rest."""
        self._goal = read_only(q)
        self._saved = 0.0

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._goal

    def step(self, target: np.ndarray, dt: float, share: float = 1.0) -> Limited:
        """Returns the goal after the next `dt` seconds.

        Args:
            target: joints to reach, shape (7,) [rad].
            dt: time since the last call [s].
            share: of the limits that counts now, (0, 1].
        """
        self._saved = min(self._saved + max(dt, 0.0), SAVED_S)
        if np.array_equal(target, self._goal):
            return Limited(self._goal, None)
        limits = self._limits.scaled(share)
        step = target - self._goal
        needed, limited_by = max(
            (float(np.max(np.abs(step) / limits.joints)), "joint speed"),
            (self._distance(target) / limits.tool, "tool speed"),
        )
        if needed <= self._saved:
            self._saved -= needed
            self._goal = read_only(target)
            return Limited(self._goal, None)
        # The way of the tool is not quite proportional to the way of the joints: take back what is too much.
        part = self._saved / needed
        excess = self._distance(self._goal + part * step) / (limits.tool * self._saved) if self._saved > 0.0 else 0.0
        if excess > 1.0:
            part /= excess
            limited_by = "tool speed"
        self._goal = read_only(self._goal + part * step)
        self._saved = 0.0
        return Limited(self._goal, limited_by)

    def _distance(self, q: np.ndarray) -> float:
        return float(np.linalg.norm(self._tool_position(q) - self._tool_position(self._goal)))
