"""The servo goals along a planned line: the way waits for goals that the limits hold back, so the tool stays on it."""

from __future__ import annotations

import numpy as np

from common.limits import Limit
from kuka_control.limits.line_plan import LinePlan
from kuka_control.limits.motion_limits import LimitedGoal, MotionLimits, Unlimited
from kuka_control.loop.goal_stream import GoalStreamSettings, ServoStream
from kuka_control.numbers import GAP_S, NO_PROGRESS_S, PROGRESS_S


class LineStream(ServoStream):
    """Makes the goals of one line; other arguments as `ServoStream`. Within the limits, the goals catch up from the
    joints q to where the plan begins. `fraction` of the way is done, 0 to 1."""

    def __init__(
        self,
        settings: GoalStreamSettings,
        limits: MotionLimits | Unlimited,
        lts: bool,
        q: np.ndarray,
        now: float,
        plan: LinePlan,
    ) -> None:
        super().__init__(settings, limits, lts, q, now)
        self._plan = plan
        self.fraction = 0.0
        self._elapsed = 0.0  # of the plan [s]
        self._rate = 1.0  # of the plan's time
        self._progress = 0.0, now  # of the plan, and when
        self._limited_by: Limit | None = None

    @property
    def q_goal(self) -> np.ndarray:
        """The joints at the end of the line, shape (7,) [rad]."""
        return self._plan.q_goal

    @property
    def arrived(self) -> bool:
        return self.fraction == 1.0 and self._limits.at_rest and np.array_equal(self._limits.goal, self._plan.q_goal)

    def blocked(self, now: float) -> str | None:
        """Returns what has held the line for `NO_PROGRESS_S`, the end of a sentence; None while it continues."""
        if self._elapsed - self._progress[0] >= PROGRESS_S:
            self._progress = self._elapsed, now
        if now - self._progress[1] <= NO_PROGRESS_S:
            return None
        return f"held by {self._limited_by or 'the arm'} at {100.0 * self.fraction:.0f} % of it"

    def goal(self, measured: np.ndarray, now: float) -> LimitedGoal:
        """Returns the goal of this cycle for the robot; `measured` are the joints of the arm, shape (7,) [rad]."""
        dt, self._time = now - self._time, now
        begin = 0.001  # a goal that is so far behind the plan slows it down [rad]
        end = 0.004  # so far behind, the plan waits [rad]
        resumes = 0.25  # the plan reaches its pace again in this time [s]
        behind = float(np.max(np.abs(self._plan.at(self._elapsed)[0] - self._limits.goal)))
        rate = 0.0 if dt > GAP_S else min(max((end - behind) / (end - begin), 0.0), self._rate + dt / resumes, 1.0)
        self._rate = rate
        self._elapsed = min(self._elapsed + rate * dt, self._plan.duration)
        q, v, self.fraction = self._plan.at(self._elapsed)
        limited = self._limits.step(q, measured, dt, 1.0, rate * v)
        self._limited_by = limited.limited_by
        return self._for_robot(limited, measured, dt)
