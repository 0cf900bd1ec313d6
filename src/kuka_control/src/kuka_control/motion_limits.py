"""Servo goals within the speed limits: how far the goal may go towards its target in one cycle.

The goal goes straight towards the target in joint space, as fast as the slowest of the limits lets it. A target that
the limits allow becomes the goal at once, unchanged: then this step adds no lag. Accelerations are not looked at here.

Targets come at uneven times, in between the target stands still. So a goal may use the time since the goal moved last,
and a little of what was left over then, and a target that moves slowly enough is not held back for its uneven arrival.

The goal also waits for the arm: the servo law of the toolbox goes no faster for a goal that is further away than
`LEAD_RAD`, and an arm with such a way to make up for is too fast when its target slows down.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.poses import read_only

SAVED_S = 0.012
"""The most time that a single goal may use up [s]; also what a stall of the loop cannot exceed."""

CARRIED_S = 0.005
"""The most time that a goal may leave over for the next one [s]; more would let the tool be too fast for a while."""

LEAD_RAD = 0.1
"""How far a goal may be ahead of the measured joint [rad]: there the servo law has reached 97 % of its step
(reference: kst.md, 2.5)."""


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
        limited_by: "joint speed", "tool speed" or "lag of the arm", what held the goal back; None when it is the
            target itself.
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

    def step(self, target: np.ndarray, measured: np.ndarray, dt: float, share: float = 1.0) -> Limited:
        """Returns the goal after the next `dt` seconds.

        Args:
            target: joints to reach, shape (7,) [rad].
            measured: joints of the arm, shape (7,) [rad].
            dt: time since the last call [s].
            share: of the speed limits that counts now, (0, 1].
        """
        self._saved = min(self._saved + max(dt, 0.0), SAVED_S)
        if np.array_equal(target, self._goal):
            return Limited(self._goal, None)
        limits = self._limits.scaled(share)
        step = target - self._goal
        needed = max(float(np.max(np.abs(step) / limits.joints)), self._way(target) / limits.tool)
        part, limited_by = min(
            (1.0, None) if needed <= self._saved else self._part(step, limits),
            (self._room(step, measured), "lag of the arm"),
            key=lambda candidate: candidate[0],
        )
        if limited_by is None:
            self._saved = min(self._saved - needed, CARRIED_S)
            self._goal = read_only(target)
        else:
            self._saved = 0.0
            self._goal = read_only(self._goal + part * step)
        return Limited(self._goal, limited_by)

    def _part(self, step: np.ndarray, limits: SpeedLimits) -> tuple[float, str]:
        """Returns the part of the step that the speed limits allow in the saved time, and which limit it was."""
        if self._saved <= 0.0:
            return 0.0, "joint speed"
        part = min(self._saved / float(np.max(np.abs(step) / limits.joints)), 1.0)
        excess = self._way(self._goal + part * step) / (limits.tool * self._saved)
        if excess <= 1.0:
            return part, "joint speed"
        # The way of the tool is not quite proportional to that of the joints: a second look takes the rest back.
        part /= excess
        return part / max(self._way(self._goal + part * step) / (limits.tool * self._saved), 1.0), "tool speed"

    def _room(self, step: np.ndarray, measured: np.ndarray) -> float:
        """Returns the part of the step after which the first joint is LEAD_RAD ahead of the arm."""
        way = np.abs(step)
        allowed = np.maximum(LEAD_RAD - np.sign(step) * (self._goal - measured), 0.0)
        held = way > allowed
        return float(np.min(allowed[held] / way[held])) if np.any(held) else 1.0

    def _way(self, q: np.ndarray) -> float:
        """Returns the distance [m] from the tool at the last goal to the tool at q."""
        return float(np.linalg.norm(self._tool_position(q) - self._tool_position(self._goal)))
