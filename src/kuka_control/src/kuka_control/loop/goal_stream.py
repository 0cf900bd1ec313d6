"""The servo goals of one stay in servo mode: from joint targets to goals within the limits.

A target may be far from the one before. If the desired tool frame itself jumped, or the joints are too far off, the arm
does not servo there; else it catches up slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kuka_control.limits.jump import FrameSteps, is_jump
from kuka_control.limits.motion_limits import MotionLimits, Unlimited
from kuka_control.loop.servo_law import LtsGoals
from kuka_control.loop.target_motion import MovingTarget, TargetMotion
from kuka_control.loop.tracking import TrackingMonitor
from kuka_control.loop.transitions import Trigger
from kuka_control.model.desired_frame import DesiredFrame

CATCH_UP_SCALE = 1.0 / 3.0
"""Fraction of the speed limits until the arm has caught up with a hand that moved on while the arm could not follow:
while the pick-up motion ran, or out of reach."""

CATCH_UP_RAD = float(np.radians(60.0))
"""Joints that differ by more than this are not caught up with in servo mode but by a pick-up motion."""


@dataclass(frozen=True)
class GoalStreamSettings:
    """Settings of the stream of goals.

    Attributes:
        joint_speeds: limits of the stream, shape (7,) [rad/s].
        tool_speed: limit of the stream [m/s].
        shaped: whether the stream is shaped; if not, every target is a goal as it is.
        lower: least joint angles of a goal, shape (7,) [rad].
        upper: greatest joint angles of a goal, shape (7,) [rad].
    """

    joint_speeds: np.ndarray
    tool_speed: float
    shaped: bool
    lower: np.ndarray
    upper: np.ndarray


@dataclass(frozen=True)
class Goal:
    """A goal for the robot, shape (7,) [rad], and what limited it, None if nothing did."""

    q: np.ndarray
    limited_by: str | None


class GoalStream:
    """Makes the goals of one stay in servo mode, which starts at rest.

    Args:
        settings: the settings.
        limits: of the motion.
        lts: whether goals are made for a server with the LTS law.
        q: joints at the start, shape (7,) [rad].
        now: monotonic time of the start [s].
    """

    def __init__(
        self, settings: GoalStreamSettings, limits: MotionLimits | Unlimited, lts: bool, q: np.ndarray, now: float
    ) -> None:
        limits.reset(q)
        self._settings = settings
        self._limits = limits
        self._monitor = TrackingMonitor()
        self._motion = TargetMotion(settings.lower, settings.upper, q)
        self._frames = FrameSteps(settings.tool_speed, float(np.max(settings.joint_speeds)))
        self._lts = LtsGoals(settings.lower, settings.upper) if lts else None
        self._stamp: float | None = None
        self._catching_up = True
        self._time = now

    @property
    def q_target(self) -> np.ndarray:
        """The joints of the last target, shape (7,) [rad]."""
        return self._motion.q

    def lag(self, measured: np.ndarray, now: float) -> str | None:
        """Returns None while the arm follows its goals, else what is wrong, as a part of a sentence."""
        return self._monitor.step(self._limits.goal, measured, now)

    def take(self, frame: DesiredFrame, q: np.ndarray | None, measured: np.ndarray, now: float) -> Trigger | None:
        """Takes a new desired tool frame; returns why its joints are not to be servoed to, None if they are.

        Args:
            frame: the frame.
            q: its joints, shape (7,) [rad]; None if there are none, then the arm keeps its joints.
            measured: joints of the arm, shape (7,) [rad].
            now: monotonic time [s].
        """
        self._frames.take(frame)
        if q is None:
            self._motion.hold()
            return None
        trigger = self._too_far(q, frame.stamp, measured)
        if trigger is None:
            self._motion.take(q, frame.stamp, now)
            self._frames.followed()
            self._stamp = frame.stamp
        return trigger

    def goal(self, measured: np.ndarray, now: float) -> Goal:
        """Returns the goal of this cycle; `measured` are the joints of the arm, shape (7,) [rad]."""
        dt, self._time = now - self._time, now
        target = self._motion.at(now) if self._settings.shaped else MovingTarget(self._motion.q, np.zeros(7))
        scale = CATCH_UP_SCALE if self._catching_up else 1.0
        limited = self._limits.step(target.q, measured, dt, scale, target.v)
        if limited.limited_by is None and self._stamp is not None:
            self._catching_up = False
        q = limited.q if self._lts is None else self._lts.step(limited.q, limited.v, measured, dt)
        return Goal(q, limited.limited_by)

    def _too_far(self, q: np.ndarray, stamp: float, measured: np.ndarray) -> Trigger | None:
        speeds, shaped = self._settings.joint_speeds, self._settings.shaped
        if self._stamp is None:
            return None if shaped or not is_jump(measured, q, 0.0, speeds) else Trigger.MOVED_ON
        before = self._motion.q
        if not is_jump(before, q, stamp - self._stamp, speeds):
            return None
        if self._frames.jumped:
            return Trigger.JUMPED
        if shaped and np.max(np.abs(q - before)) <= CATCH_UP_RAD:
            self._motion.hold()
            self._catching_up = True
            return None
        return Trigger.JOINTS_JUMPED
