"""The two algorithms, real time and PTP, and how they are put together from the configuration and the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from common.limits import Limit
from iiwa_kinematics import Ball
from kuka_control.limits.line_plan import LineLimits
from kuka_control.limits.motion_limits import LimitedGoal, MotionLimits, Unlimited
from kuka_control.limits.moving_arm import GuardError, MovingPoints, ShapeLimits
from kuka_control.limits.speed_change import GuardedRoom
from kuka_control.loop.commands import Servo, Wait
from kuka_control.loop.control_loop import ControlLoop, Cycle, Fired, LoopSettings, Outcome
from kuka_control.loop.goal_stream import (
    SETTLED_RAD,
    TOLERANCE_RAD,
    GoalStream,
    GoalStreamSettings,
    ServoStream,
)
from kuka_control.loop.line_stream import LineStream
from kuka_control.loop.moves import MovePlanner, ProgramMotion
from kuka_control.loop.servo_law import ServoLawIdentification, ServoLawVerdict, verdict
from kuka_control.loop.transitions import PTP_STATES, REAL_TIME_STATES, State, Trigger
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig
from kuka_control.model.ptp_contact import torque_ranges
from kuka_control.model.rig import Rig
from kuka_control.model.robot_shape import Opening
from kuka_control.model.target import TargetChain
from kuka_control.numbers import HOLD_HZ, SPEED_MARGIN, TEST_MOTIONS

if TYPE_CHECKING:
    from kuka_control.limits.collision import CollisionGuard


@dataclass(frozen=True)
class RealTimeSettings(LoopSettings):
    servo_law: str  # law of the robot's servo loop that the goals are to be made for, "auto", "lts" or "none"
    goals: GoalStreamSettings  # the settings of the stream of goals
    carried: Callable[[Opening | None], Iterable[Ball]]  # what the flange carries at an opening of the hand


class RealTimeLoop(ControlLoop[RealTimeSettings]):
    """Picks the desired tool frame up by a PTP motion, then follows it by servo goals. Before the first stream a
    small motion at home identifies the servo law of the robot's controller. Goals that are meant for another law
    would be wrong by far, so then the controller exits without having followed anything."""

    STATES = REAL_TIME_STATES
    PICK_UP = "the pick-up pose"
    LEAST_RATE_HZ = HOLD_HZ

    def __init__(self, settings: RealTimeSettings, chain: TargetChain, limits: MotionLimits | Unlimited) -> None:
        super().__init__(settings, chain)
        self._limits = limits
        self._law: ServoLawVerdict | None = None
        self._test_motions = 0
        self._handlers.update(
            {
                State.IDENTIFYING: self._identifying,
                State.IDENTIFIED: self._identified,
                State.SERVO: self._servo,
                State.BRAKING: self._braking,
                State.SERVO_LEFT: self._at_rest,
                State.RETURN_PENDING: self._return_pending,
                State.LINE: self._line,
                State.LINE_BRAKING: self._braking,
            }
        )

    @property
    def goal(self) -> np.ndarray:
        """The joints where the stream is, shape (7,) [rad]; what is sent may differ for the servo law."""
        return self._limits.goal

    def open_hand(self, opening: Opening | None) -> None:
        """As for all loops; the speed limits of the stream hold for the finger tips, too."""
        if opening != self._opening:
            self._limits.carry(self._settings.carried(opening))
        super().open_hand(opening)

    def _arrived(self, cycle: Cycle) -> Fired:
        if self._active.state is State.HOMING and self._law is None and not self._exits(cycle):
            return Fired(Trigger.ARRIVED_UNIDENTIFIED)
        return super()._arrived(cycle)

    def _identifying(self, cycle: Cycle) -> Outcome:
        joints = cycle.observation.joints
        if self._active.data is None:
            self._active = replace(self._active, data=ServoLawIdentification(joints))
        identification: ServoLawIdentification = self._active.data
        goal, result = identification.step(joints, cycle.now)
        if result is None:
            return Servo(goal)
        self._test_motions += 1
        again = self._test_motions < TEST_MOTIONS and not self._exits(cycle)
        if again and result.badly_seen and self._settings.servo_law == "auto":
            self._active = replace(self._active, data=ServoLawIdentification(identification.rest))
            return Servo(goal)
        self._law = verdict(result, self._settings.servo_law)
        if not self._law.refused:
            self._report(self._law.level, self._law.sentence)
        return Fired(Trigger.LAW_IDENTIFIED)

    def _identified(self, cycle: Cycle) -> Outcome:
        if self._law is not None and self._law.refused:
            return Fired(Trigger.WRONG_LAW, self._law.sentence)
        return Fired(Trigger.SERVO_ENDED)

    def _return_pending(self, cycle: Cycle) -> Outcome:
        return Fired(Trigger.EXIT if self._exits(cycle) else Trigger.SERVO_ENDED)

    def _follow(self, distance: float) -> Outcome:
        if distance <= TOLERANCE_RAD:
            return Fired(Trigger.NEAR_TARGET)
        return Fired(Trigger.FAR_TARGET)

    def _servo(self, cycle: Cycle) -> Outcome:
        leaves = self._leaves(cycle)
        if leaves is not None:
            return leaves
        if self._admission.barred is not None:
            return Fired(Trigger.CONFLICT, self._admission.barred)
        joints = cycle.observation.joints
        if self._active.data is None:
            lts = self._law is not None and self._law.lts
            stream = GoalStream(self._settings.goals, self._limits, lts, joints, cycle.now)
            self._active = replace(self._active, data=stream)
        goals: GoalStream = self._active.data
        lag = goals.lag(joints, cycle.now)
        if lag is not None:
            return Fired(Trigger.LAG, lag)
        stamp = None
        if cycle.fresh is not None:
            stall = goals.hear(cycle.fresh, cycle.now)
            self._admission.hear_rate(goals.too_rare)
            q = self._resolve(cycle.fresh, goals.q_target)
            if self._infeasible is not None:
                return Fired(Trigger.INFEASIBLE, self._infeasible)
            too_far = goals.take(cycle.fresh, q, joints, cycle.now, stall)
            if too_far is not None:
                return Fired(too_far)
            stamp = None if q is None else cycle.fresh.stamp
        try:
            return self._sent(goals.goal(joints, cycle.now), stamp)
        except GuardError as error:
            return Fired(Trigger.GUARD_FAILED, str(error))

    def _line(self, cycle: Cycle) -> Outcome:
        switched = self._switched(cycle)
        if switched is not None:
            return switched
        if self._cancelled:
            return Fired(Trigger.CANCELLED)
        joints = cycle.observation.joints
        if self._active.data is None:
            assert self._move is not None and self._move.line is not None, "a line was asked for"
            lts = self._law is not None and self._law.lts
            stream = LineStream(self._settings.goals, self._limits, lts, joints, cycle.now, self._move.line)
            self._active = replace(self._active, data=stream)
        goals: LineStream = self._active.data
        lag = goals.lag(joints, cycle.now)
        if lag is not None:
            return Fired(Trigger.LAG, lag)
        if goals.arrived and float(np.max(np.abs(joints - goals.q_goal))) <= SETTLED_RAD:
            return Fired(Trigger.ARRIVED)
        blocked = goals.blocked(cycle.now)
        if blocked is not None:
            return Fired(Trigger.NO_PROGRESS, blocked)
        try:
            return self._sent(goals.goal(joints, cycle.now))
        except GuardError as error:
            return Fired(Trigger.GUARD_FAILED, str(error))

    def _progress_at(self, move: ProgramMotion, joints: np.ndarray) -> tuple[float, float]:
        """As for all motions; that of a line counts in the way of the tool."""
        if move.line is None:
            return super()._progress_at(move, joints)
        fraction = self._active.data.fraction if isinstance(self._active.data, LineStream) else 0.0
        return fraction, (1.0 - fraction) * move.line.length

    def _sent(self, goal: LimitedGoal, stamp: float | None = None) -> Servo:
        if goal.limited_by is not None:
            self.counts["limited_goals"] += 1
            self.counts["goal_gaps"] += goal.limited_by == Limit.LATE_GOAL
            self._limited_by = (goal.limited_by,)
        self.counts["goals_sent"] += 1
        return Servo(goal.q, stamp, self.goal)

    def _braking(self, cycle: Cycle) -> Outcome:
        goals: ServoStream | None = self._active.data
        if goals is not None and self._active.state is State.LINE_BRAKING:
            lag = goals.lag(cycle.observation.joints, cycle.now)
            if lag is not None:
                return Fired(Trigger.LAG, lag)
        goal = None if goals is None else goals.brake(cycle.observation.joints, cycle.now)
        if goal is None:
            return Fired(self._active.at_rest)
        self.counts["goals_sent"] += 1
        return Servo(goal.q, reached=self.goal)


@dataclass(frozen=True)
class PtpSettings(LoopSettings):
    """Settings of the PTP loop besides; `joints_thresh`: smaller joint steps are not executed [rad]."""

    joints_thresh: float


class PtpLoop(ControlLoop[PtpSettings]):
    """Every desired tool frame that is far enough away is one PTP motion."""

    STATES = PTP_STATES
    PICK_UP = "the desired pose"
    NOT_COUNTED = frozenset({"pickups"})  # each motion goes to a desired pose

    def _follow(self, distance: float) -> Outcome:
        return Wait() if distance <= self._settings.joints_thresh else Fired(Trigger.FAR_TARGET)


RANGE_MARGIN_RAD = float(np.radians(0.1))
"""Servo goals keep this distance to the ends of the joint ranges, where the robot's controller would end servo mode."""


def real_time_loop(config: RealTimeConfig, rig: Rig) -> RealTimeLoop:
    limits = stream_limits(config, rig)
    goals = GoalStreamSettings(
        joint_speeds=limits.joint_speeds,
        tool_speed=config.tcp_speed,
        shaped=config.shaping != "none",
        lower=limits.lower,
        upper=limits.upper,
    )
    slow, fast = config.velocity_ptp_slow, config.velocity_ptp_fast
    guard = collision_guard(config, rig)
    speeds, ranges = rig.model.max_speed, ptp_torque_ranges(config, rig)
    settings = RealTimeSettings(
        *(rig.ptp_velocity, rig.home.q, speeds, config.time_out, slow, fast, guard, ranges),
        *(config.servo_law, goals, rig.carried),
    )
    return RealTimeLoop(settings, rig.chain, motion_limits(config, rig, guard) if goals.shaped else Unlimited())


def collision_guard(config: ControllerConfig, rig: Rig) -> CollisionGuard | None:
    """Returns the collision guard, None if it is off; ValueError: its file of obstacles was not handed in."""
    if not config.collision_guard:
        return None
    from kuka_control.limits.collision import CollisionGuard  # its library takes a quarter of a second to load

    if config.guard_obstacles and rig.obstacles is None:
        raise ValueError(f"what {config.guard_obstacles} says has to be read and handed in")
    around = rig.obstacles or ()
    return CollisionGuard(rig.kinematics, config.marker_ring, around, config.guard_margin, config.allow_contact)


def ptp_torque_ranges(config: ControllerConfig, rig: Rig) -> Callable[..., np.ndarray] | None:
    """Returns what makes the ranges of the torques in PTP motions, None if nothing is to end them."""
    margin = config.ptp_contact_torque
    return partial(torque_ranges, rig.load, margin=margin) if margin > 0.0 else None


def line_limits(config: RealTimeConfig, rig: Rig) -> LineLimits | None:
    """Returns the limits of straight lines; None where the stream of goals is not shaped."""
    if config.shaping == "none":
        return None
    limits = stream_limits(config, rig)
    return LineLimits(
        kinematics=rig.kinematics,
        workspace=rig.workspace,
        lower=limits.lower,
        upper=limits.upper,
        joint_speeds=limits.joint_speeds,
        shape=limits.shape,
        speed=limits.speed,
        points=_points(rig),
    )


def move_planner(config: ControllerConfig, rig: Rig, named: Mapping[str, np.ndarray]) -> MovePlanner:
    """Returns what checks motions for programs; `named` are joints [rad], shape (7,), by name."""
    if isinstance(config, RealTimeConfig):
        slow, fast = config.velocity_ptp_slow, config.velocity_ptp_fast
        return MovePlanner(rig, named, slow, max(slow, fast), line_limits(config, rig))
    velocity = config.velocity_ptp if isinstance(config, PtpConfig) else 0.0
    return MovePlanner(rig, named, velocity, velocity, None)


class StreamLimits(NamedTuple):
    lower: np.ndarray  # joint ranges, shape (7,) [rad]
    upper: np.ndarray
    joint_speeds: np.ndarray  # shape (7,) [rad/s]
    shape: ShapeLimits
    speed: float  # of every point of the moving arm [m/s]


def stream_limits(config: RealTimeConfig, rig: Rig) -> StreamLimits:
    """Returns the limits of servo goals; faster joints change their speed more quickly in proportion."""
    fastest = rig.model.max_speed
    pace = fastest / np.min(fastest)
    return StreamLimits(
        lower=rig.model.lower + RANGE_MARGIN_RAD,
        upper=rig.model.upper - RANGE_MARGIN_RAD,
        joint_speeds=config.joint_speed * fastest,
        shape=ShapeLimits(config.joint_acceleration * pace, config.joint_jerk * pace),
        speed=SPEED_MARGIN * config.tcp_speed,
    )


def _points(rig: Rig) -> MovingPoints:
    """Returns the points of the arm whose speed is limited, with a hand whose opening is not known."""
    return MovingPoints(rig.kinematics, rig.carried(None))


def motion_limits(config: RealTimeConfig, rig: Rig, guard: CollisionGuard | None = None) -> MotionLimits:
    limits = stream_limits(config, rig)
    room = GuardedRoom(
        lower=limits.lower,
        upper=limits.upper,
        speed=limits.speed,
        points=_points(rig),
        tool_jacobian=rig.kinematics.jacobian,
        workspace=None if rig.workspace.lifted else rig.workspace,
        collisions=guard,
    )
    return MotionLimits(limits.joint_speeds, limits.shape, room)


def ptp_loop(config: PtpConfig, rig: Rig) -> PtpLoop:
    velocity, threshold = config.velocity_ptp, float(np.radians(config.joints_thresh))
    guard = collision_guard(config, rig)
    speeds, ranges = rig.model.max_speed, ptp_torque_ranges(config, rig)
    settings = PtpSettings(
        rig.ptp_velocity, rig.home.q, speeds, config.time_out, velocity, velocity, guard, ranges, threshold
    )
    return PtpLoop(settings, rig.chain)
