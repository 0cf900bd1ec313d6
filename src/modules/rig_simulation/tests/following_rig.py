"""An arm that follows the palm with a lag and a wrong scale, and an object that hangs on closed fingers."""

from __future__ import annotations

import numpy as np

from rig_simulation.operator.pick_and_place import Plan

PERIOD_S = 0.05
PLAN = Plan()
CENTER_LINE = np.array([1.0, -1.0, 0.0])
HOME = np.array([0.42, -0.42, 0.4])
TOP = np.array([0.44, -0.38, 0.21])


class FollowingRig:
    """The rig. While a hand works, the tool goes from `start` as the palm goes, seen by a person who looks `ahead`.

    Attributes:
        tool: point that grips, shape (3,) [m].
        heading: of the tool [rad].
        top: centre of the object's upper side, shape (3,) [m].
        highest: of that, ever [m].
        curls: of all moves.
    """

    def __init__(self, scale: float = 1.0, lag: float = 0.1, top: np.ndarray = TOP) -> None:
        self.tool, self.top, self.heading = HOME.copy(), top.copy(), 0.0
        self.highest = top[2]
        self.curls: list[float] = []
        self._scale, self._lag = scale, lag
        self.come_in(CENTER_LINE)

    def come_in(self, ahead: np.ndarray) -> None:
        """A hand comes in that points ahead, shape (3,)."""
        ahead = ahead / np.linalg.norm(ahead)
        up = np.array([0.0, 0.0, 1.0])
        self._R_base_leap = np.column_stack([np.cross(ahead, up), up, -ahead])
        self._start, self._start_heading = self.tool.copy(), self.heading
        self.palm, self.yaw, self.curl = np.zeros(3), 0.0, 0.0

    def make(self, move) -> None:
        """The hand moves."""
        self.palm, self.yaw, self.curl = move.palm, move.yaw, move.curl
        self.curls.append(move.curl)

    def go(self, tool: np.ndarray) -> None:
        """The tool goes on its way to a place."""
        step = (tool - self.tool) * min(1.0, PERIOD_S / self._lag)
        near = np.linalg.norm(self.tool - self.top) < PLAN.grasp_height + 0.01
        self.tool = self.tool + step
        if near and self.curl > 0.5:
            self.top = self.top + step
        self.highest = max(self.highest, self.top[2])

    def advance(self) -> None:
        """One period passes in which the arm follows the hand."""
        self.go(self._start + self._scale * (self._R_base_leap @ self.palm))
        self.heading += (self._start_heading - self.yaw - self.heading) * min(1.0, PERIOD_S / self._lag)
