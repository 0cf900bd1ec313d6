"""The real-time algorithm: pick the desired tool frame up by a PTP motion, then follow it by servo goals.

Before the first stream a small motion at home tells which servo law the robot's controller has (law_check.py). Goals
that are meant for another law would be wrong by far, so then the controller ends without having followed anything.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kuka_control.limits.jump import TOLERANCE_RAD, FrameSteps, is_jump
from kuka_control.limits.motion_limits import Limited, MotionLimits, Unlimited
from kuka_control.loop.commands import Command, Observation, Servo, StartServo, StopServo
from kuka_control.loop.control_loop import ControlLoop, LoopSettings
from kuka_control.loop.law_check import Checked, LawCheck
from kuka_control.loop.servo_law import LtsGoals
from kuka_control.loop.stream import Desired
from kuka_control.loop.target_motion import Moving, TargetMotion
from kuka_control.loop.tracking import TrackingMonitor
from kuka_control.model.target import Target, TargetChain

CATCH_UP_SHARE = 1.0 / 3.0
"""Share of the speed limits until the arm has caught up with a hand that moved on while the arm could not follow: while
the pick-up motion ran, or out of reach."""

CATCH_UP_RAD = float(np.radians(60.0))
"""Joints that differ by more than this are not caught up with in servo mode but by a pick-up motion."""


@dataclass(frozen=True)
class RealTimeSettings(LoopSettings):
    """What the real-time loop needs to know besides.

    Attributes:
        servo_joint_speeds: limits of the stream of goals, shape (7,) [rad/s].
        servo_tool_speed: limit of the stream of goals [m/s].
        servo_law: law of the robot's servo loop that the goals are made for, "lts" or "none".
        shaped: whether the stream of goals is shaped; if not, every target is a goal as it is.
        lower: least joint angles of a goal, shape (7,) [rad].
        upper: greatest joint angles of a goal, shape (7,) [rad].
    """

    servo_joint_speeds: np.ndarray
    servo_tool_speed: float
    servo_law: str
    shaped: bool
    lower: np.ndarray
    upper: np.ndarray


class RealTimeLoop(ControlLoop[RealTimeSettings]):
    """Follows the desired tool frame in servo mode."""

    def __init__(self, settings: RealTimeSettings, chain: TargetChain, limits: MotionLimits | Unlimited) -> None:
        super().__init__(settings, chain)
        self._limits = limits
        self._motion_of_target = TargetMotion(settings.lower, settings.upper)
        self._frames = FrameSteps(settings.servo_tool_speed, float(np.max(settings.servo_joint_speeds)))
        self._for_lts = LtsGoals(settings.lower, settings.upper)
        self._lts = False
        self._check: LawCheck | None = None
        self._checked = False
        self._monitor = TrackingMonitor()
        self._target_stamp: float | None = None
        self._catching_up = True
        self._servo_time = 0.0
        self._fault = ""
        self._refusal: str | None = None

    @property
    def goal(self) -> np.ndarray:
        """The joints where the stream is, shape (7,) [rad]; what is sent may differ for the servo law."""
        return self._limits.goal

    def _home(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._checked or self._leaving(seen):
            return super()._home(seen, fresh, now)
        self._enter("homing", self._checking, "The arm is at home; a small motion of joint 7 shows its servo law.")
        self._check = None
        return StartServo()

    def _checking(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._check is None:
            self._check = LawCheck(seen.joints)
        checked = self._check.step(seen.joints, now)
        if not (checked.done or self._leaving(seen)):
            return Servo(checked.goal)
        self._state = self._after_check
        if checked.done:
            self._judge(checked)
        return StopServo()

    def _judge(self, checked: Checked) -> None:
        wanted = self._settings.servo_law
        self._checked = True
        self._lts = wanted == checked.law == "lts"
        if checked.law is None:
            without = " Goals are sent as for servo_law none." if wanted == "lts" else ""
            self._say("warn", f"The servo law of the robot's controller is unclear: {checked.seen}.{without}")
        elif wanted == checked.law:
            self._say("info", f"The servo law of the robot's controller is {wanted}, as set: {checked.seen}.")
        elif wanted == "none":
            self._say(
                "info",
                f"The robot's controller shows the servo law lts ({checked.seen}); with the parameter "
                "servo_law: lts the arm would follow closer.",
            )
        else:
            self._refusal = (
                f"The parameter servo_law is lts, but the robot's controller goes straight for its goals "
                f"({checked.seen}); with lts they would be far too large. Set servo_law: none."
            )

    def _after_check(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._refusal is not None:
            return self._end(self._refusal)
        return super()._home(seen, fresh, now)

    def _follow(self, seen: Observation, target: Target, now: float) -> Command:
        assert target.q is not None, "only what can be reached is followed"
        if np.max(np.abs(target.q - seen.joints)) <= TOLERANCE_RAD:
            return self._start_servo()
        self.counts["pickups"] += 1
        velocity = self._settings.velocity_return
        return self._ptp(seen, "the pick-up pose", target.q, velocity, "pick_up", self._picked_up, now)

    def _picked_up(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._leaving(seen) or self._must_return(seen, now):
            self._state = self._at_rest
            return self._at_rest(seen, fresh, now)
        return self._start_servo()

    def _start_servo(self) -> Command:
        self._enter("servo", self._joining, "The arm follows the desired tool frame in servo mode.")
        self._at_home = False
        return StartServo()

    def _joining(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """The first step in servo mode: everything starts from where the arm is."""
        self._limits.reset(seen.joints)
        self._monitor.reset()
        self._motion_of_target.reset(seen.joints)
        self._frames.reset()
        self._for_lts.reset()
        self._target_stamp = None
        self._catching_up = True
        self._servo_time = now
        self._state = self._servoing
        return self._servoing(seen, fresh, now)

    def _servoing(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        if self._leaving(seen) or self._must_return(seen, now):
            return self._leave_servo()
        fault = self._monitor.step(self._limits.goal, seen.joints, now)
        if fault is not None:
            self._fault = f"The arm does not follow, perhaps because of a safety stop: {fault}."
            self._state = self._giving_up
            return Servo(seen.joints)
        stamp = None
        if fresh is not None:
            self._frames.take(fresh)
            target = self._resolve(seen, fresh, self._motion_of_target.q)
            if self._leaving(seen):
                return self._leave_servo()
            if target is None or target.q is None:
                self._motion_of_target.hold()
            elif self._too_far(target.q, fresh.stamp, seen.joints):
                return self._leave_servo()
            else:
                self._motion_of_target.take(target.q, fresh.stamp, now)
                self._frames.followed()
                stamp = self._target_stamp = fresh.stamp
        dt, self._servo_time = now - self._servo_time, now
        return self._goal(self._limited(seen, now, dt), seen, dt, stamp)

    def _limited(self, seen: Observation, now: float, dt: float) -> Limited:
        motion = self._motion_of_target
        target = motion.at(now) if self._settings.shaped else Moving(motion.q, np.zeros(7))
        share = CATCH_UP_SHARE if self._catching_up else 1.0
        limited = self._limits.step(target.q, seen.joints, dt, share, target.v)
        if limited.limited_by is not None:
            self.counts["limited_goals"] += 1
            self._limited_by = (limited.limited_by,)
        caught_up = limited.limited_by is None and self._target_stamp is not None
        self._catching_up &= not caught_up
        return limited

    def _leave_servo(self) -> Command:
        mode = "pick_up" if self._home_at is None else "returning"
        self._enter(mode, self._at_rest, f"{self._because} The arm leaves servo mode.".strip())
        return StopServo()

    def _giving_up(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """The goal is where the arm is, so that it does not start when it is released; now servo mode ends."""
        self._latch(self._fault)
        return StopServo()

    def _too_far(self, q: np.ndarray, stamp: float, joints: np.ndarray) -> bool:
        """Returns whether a target is not to be servoed to, and remembers why.

        The arm catches up with one that is far from the one before although the frame did not jump.
        """
        speeds, shaped = self._settings.servo_joint_speeds, self._settings.shaped
        if self._target_stamp is None:
            if shaped or not is_jump(joints, q, 0.0, speeds):
                return False
            self._because = "The desired tool frame moved on while the arm was on its way."
            return True
        before = self._motion_of_target.q
        if not is_jump(before, q, stamp - self._target_stamp, speeds):
            return False
        if self._frames.jumped:
            self.counts["jumps"] += 1
            self._because = "The desired tool frame jumped."
            return True
        if shaped and np.max(np.abs(q - before)) <= CATCH_UP_RAD:
            self._motion_of_target.hold()
            self._catching_up = True
            return False
        self.counts["flips"] += 1
        self._because = "The desired tool frame did not jump, but asks for joints far from those before."
        return True

    def _goal(self, limited: Limited, seen: Observation, dt: float, stamp: float | None) -> Command:
        self.counts["goals_sent"] += 1
        q = self._for_lts.step(limited.q, limited.v, seen.joints, dt) if self._lts else limited.q
        return Servo(q, stamp)
