"""The real-time algorithm: pick the desired tool frame up by a PTP motion, then follow it by servo goals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kuka_control.commands import Command, Observation, Servo, StartServo, StopServo
from kuka_control.control_loop import ControlLoop, LoopSettings
from kuka_control.jump import TOLERANCE_RAD, is_jump
from kuka_control.motion_limits import MotionLimits
from kuka_control.stream import Desired
from kuka_control.target import Target, TargetChain
from kuka_control.tracking import TrackingMonitor

CATCH_UP_SHARE = 1.0 / 3.0
"""Share of the speed limits until the arm has caught up with a hand that moved on while the pick-up motion ran."""


@dataclass(frozen=True)
class RealTimeSettings(LoopSettings):
    """What the real-time loop needs to know besides.

    Attributes:
        servo_joint_speeds: limits of the stream of goals, shape (7,) [rad/s].
    """

    servo_joint_speeds: np.ndarray


class RealTimeLoop(ControlLoop):
    """Follows the desired tool frame in servo mode."""

    def __init__(self, settings: RealTimeSettings, chain: TargetChain, limits: MotionLimits) -> None:
        super().__init__(settings, chain)
        self._limits = limits
        self._monitor = TrackingMonitor()
        self._target: np.ndarray | None = None
        self._target_stamp: float | None = None
        self._catching_up = True
        self._servo_time = 0.0
        self._fault = ""

    def _follow(self, seen: Observation, target: Target, now: float) -> Command:
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
        self._target, self._target_stamp = seen.joints, None
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
            target = self._resolve(seen, fresh, self._target)
            if self._leaving(seen):
                return self._leave_servo()
            if target is not None:
                if self._jumped(target.q, fresh.stamp):
                    self.counts["jumps"] += 1
                    self._because = "The desired tool frame jumped."
                    return self._leave_servo()
                self._target, self._target_stamp = target.q, fresh.stamp
                stamp = fresh.stamp
        share = CATCH_UP_SHARE if self._catching_up else 1.0
        limited = self._limits.step(self._target, seen.joints, now - self._servo_time, share)
        self._servo_time = now
        if limited.limited_by is not None:
            self.counts["limited_goals"] += 1
            self._limited_by = (limited.limited_by,)
        elif self._target_stamp is not None:
            self._catching_up = False
        return self._goal(limited.q, stamp)

    def _leave_servo(self) -> Command:
        mode = "pick_up" if self._home_at is None else "returning"
        self._enter(mode, self._at_rest, f"{self._because} The arm leaves servo mode.".strip())
        return StopServo()

    def _giving_up(self, seen: Observation, fresh: Desired | None, now: float) -> Command:
        """The goal is where the arm is, so that it does not start when it is released; now servo mode ends."""
        self._latch(self._fault)
        return StopServo()

    def _jumped(self, q: np.ndarray, stamp: float) -> bool:
        if self._target_stamp is None:
            return False
        return is_jump(self._target, q, stamp - self._target_stamp, self._settings.servo_joint_speeds)

    def _goal(self, q: np.ndarray, stamp: float | None = None) -> Command:
        self.counts["goals_sent"] += 1
        return Servo(q, stamp)
