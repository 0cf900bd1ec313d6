"""Servo goals within limits of speed, acceleration and jerk: the motion of the goal in one cycle.

The desired velocity is that of the target plus a correction of the distance to it, no faster than the joints can brake
before the target. One factor scales all joints down to what the joint speeds, the speed of the arm's fastest point and
the lag of the arm allow, so that the path stays straight. Ruckig then changes the present velocity into the desired
one; the guard (speed_change.py) takes a step only if the arm could then still stop in time. A target that moves
steadily within the limits is met without lag. Near a singular pose the slowest joint sets the pace of all, on the way
in and out."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from common.limits import Limit
from common.poses import read_only
from iiwa_kinematics import Ball
from kuka_control.limits.moving_arm import JointState, ShapeLimits, approach_speed
from kuka_control.limits.speed_change import GuardedRoom, SpeedChange, StoppingGuard
from kuka_control.numbers import GAP_S

GAIN_PER_S = 40.0  # gain on a small distance between goal and target [1/s]
LATE_S = 0.04  # if a velocity change takes longer than this, the limits of acceleration and jerk hold the goal back [s]

ARM_S = 0.03  # expected lag of an arm whose drives have a time constant of 40 ms [s]
LEAD_RAD = (0.035, 0.065)
"""Excess lag of the arm at which the goal begins to slow down, and at which it waits [rad].

The toolbox's servo law hardly speeds up for a more distant goal (docs/handbook/wire-protocols.md, "Servo mode"), and an
arm that catches up such a lag is too fast when its target slows down."""

AT_REST = read_only([0.0] * 7)  # the velocity at rest, shape (7,) [rad/s]
AT_REST_RAD_S = 1e-4  # a goal this close to a resting target, and this slow, is set to the target


@dataclass(frozen=True)
class LimitedGoal:
    """A servo goal: joints [rad] and their velocities [rad/s], shape (7,) each."""

    q: np.ndarray
    v: np.ndarray
    limited_by: Limit | None  # what holds the goal back; None if it moves with the desired velocity


class MotionLimits:
    """Follows a moving target within the limits; `joint_speeds`: of shape (7,) [rad/s]; `room`: the joint ranges and
    the workspace that no goal leaves, and the speed limit of the arm's points."""

    def __init__(self, joint_speeds: np.ndarray, shape: ShapeLimits, room: GuardedRoom) -> None:
        # of the acceleration limit, with which braking is planned; the jerk limit costs the rest
        braking_fraction = 0.4
        self._joint_speeds = joint_speeds.tolist()
        self._room = room
        self._braking = (braking_fraction * shape.acceleration).tolist()
        self._ranges = list(zip(room.lower.tolist(), room.upper.tolist(), self._braking))
        self._change = SpeedChange(shape)
        self._guard = StoppingGuard(self._change, room, shape.acceleration)
        self._slow = False  # whether the last goal came after a gap
        self.reset(np.zeros(7))

    def reset(self, q: np.ndarray | list[float]) -> None:
        """Starts from the joints q, shape (7,) [rad], at rest."""
        self._goal = read_only(q)
        self._now = JointState.rest(self._goal.tolist())

    def carry(self, balls: Iterable[Ball]) -> None:
        """Takes over what the flange carries from now on."""
        self._room.points.carry(balls)

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._goal

    @property
    def at_rest(self) -> bool:
        return not (any(self._now.v) or any(self._now.a))

    def brake(self, dt: float) -> LimitedGoal:
        """Returns the goal after the next `dt` seconds on the way to the earliest stop within the limits."""
        dt = self._after(dt)
        stopped = self._change.stop(self._now, dt)
        at_rest = stopped.duration <= dt
        return self._moved(JointState.rest(stopped.q) if at_rest else stopped, None)

    def step(
        self,
        target: np.ndarray,
        measured: np.ndarray,
        dt: float,
        scale: float = 1.0,
        speed: np.ndarray | None = None,
        cap: float = 1.0,
    ) -> LimitedGoal:
        """Returns the goal after the next `dt` seconds.

        Args:
            target: joints of the target then, shape (7,) [rad].
            measured: joints of the arm, shape (7,) [rad].
            dt: time since the last goal was sent [s].
            scale: scaling factor of the speed limits, (0, 1]; a faster target is approached with half of that factor
                on top of its own speed.
            speed: velocity of the target, shape (7,) [rad/s]; None: at rest.
            cap: upper bound of the scaling factor, [0, 1], also for what the target needs by itself."""
        at_rest_rad = 1e-7
        if self._room.collisions is not None:
            self._room.collisions.follow(self._now.q, measured, dt)
        gap = Limit.LATE_GOAL if dt > GAP_S else None
        dt = self._after(dt)
        own = [0.0] * 7 if speed is None else speed.tolist()
        q, v, ahead = self._now.q, self._now.v, target.tolist()
        at_rest = not any(own) and max(map(abs, v)) < AT_REST_RAD_S
        if at_rest and max([abs(a - b) for a, b in zip(ahead, q)]) < at_rest_rad:
            self.reset(target)
            return LimitedGoal(self._goal, AT_REST, None)
        error = [a - b - dt * rate for a, b, rate in zip(ahead, q, v)]
        desired, held_by = self._desired_velocity(error, own)
        if scale < 1.0:
            needed = max(self._joint_fraction(own), self._arm_fraction(own))
            scale = min(1.0, max(scale, needed + 0.5 * scale))
        allowed, limited_by = self._allowed(desired, measured.tolist(), min(scale, cap))
        if cap < scale and limited_by in (Limit.JOINT_SPEED, Limit.ARM_SPEED):
            limited_by = Limit.FRAME_RATE
        within, slowed = self._in_ranges(allowed)
        if slowed:
            limited_by = limited_by or Limit.JOINT_RANGE
        if self._room.collisions is not None:
            within, slowed = self._room.collisions.slowed(q, within)
            if slowed:
                limited_by = Limit.COLLISION_GUARD
        now, held = self._guard.step(self._now, within, dt)
        late = Limit.ACCELERATION if now.duration > LATE_S else None
        return self._moved(now, gap or held or limited_by or held_by or late)

    def _moved(self, now: JointState, limited_by: Limit | None) -> LimitedGoal:
        self._now, self._goal = now, read_only(now.q)
        return LimitedGoal(self._goal, read_only(now.v), limited_by)

    def _after(self, dt: float) -> float:
        """Returns the time that the goal moves on [s]; after a gap it rests first where it is. Where one gap follows
        the other it moves on from rest, so that a slow link or machine does not stop the arm."""
        slow, self._slow = self._slow, dt > GAP_S
        if not self._slow:
            return max(dt, 0.0)
        self.reset(self._now.q)
        return GAP_S if slow else 0.0

    def _in_ranges(self, velocity: list[float]) -> tuple[list[float], bool]:
        """Returns the velocity from which each joint can brake within its range, and whether one is slowed down."""
        within, slowed = [], False
        for rate, angle, (lower, upper, braking) in zip(velocity, self._now.q, self._ranges):
            room = upper - angle if rate > 0.0 else angle - lower
            most = approach_speed(room, braking, GAIN_PER_S)
            if abs(rate) > most:
                slowed = slowed or abs(rate) - most > AT_REST_RAD_S
                rate = math.copysign(most, rate)
            within.append(rate)
        return within, slowed

    def _desired_velocity(self, error: list[float], speed: list[float]) -> tuple[list[float], Limit | None]:
        """Returns the desired velocity, and ACCELERATION if braking before the target limits it."""
        # In units of what each joint brakes with, distances are squares of times.
        far = max([abs(e) / braking for e, braking in zip(error, self._braking)])
        braking = far * GAIN_PER_S**2 > 1.0
        gain = approach_speed(far, 1.0, GAIN_PER_S) / far if braking else GAIN_PER_S
        return [v + gain * e for v, e in zip(speed, error)], Limit.ACCELERATION if braking else None

    def _allowed(self, desired: list[float], measured: list[float], scale: float) -> tuple[list[float], Limit | None]:
        """Returns the desired velocity scaled down to the limits, and the limit that scales it down most."""
        least_used = 1e-9  # fraction of a speed limit below which nothing moves
        fastest, limited_by = self._joint_fraction(desired), None
        arm = self._arm_fraction(desired, scale)
        used = max(fastest, arm, least_used)
        if used > scale:
            factor = scale / used
            limited_by = Limit.JOINT_SPEED if fastest > arm else Limit.ARM_SPEED
            desired = [factor * rate for rate in desired]
        behind = 0.0
        for rate, angle, joint in zip(desired, self._now.q, measured):
            if rate > 0.0:
                behind = max(behind, angle - joint - ARM_S * rate)
            elif rate < 0.0:
                behind = max(behind, joint - angle + ARM_S * rate)
        begin, end = LEAD_RAD
        room = (end - behind) / (end - begin)
        if room >= 1.0:
            return desired, limited_by
        return [max(room, 0.0) * rate for rate in desired], Limit.LAG

    def _joint_fraction(self, velocity: list[float]) -> float:
        return max([abs(rate) / limit for rate, limit in zip(velocity, self._joint_speeds)])

    def _arm_fraction(self, velocity: list[float], enough: float = 0.0) -> float:
        """Returns the fraction of its speed limit that the arm uses; not exactly where it is below `enough`. No
        point moves faster than all joints would move it if they did so in one direction."""
        points, q, limit = self._room.points, self._now.q, self._room.speed
        most = sum([abs(rate) * reach for rate, reach in zip(velocity, points.tool_point(q)[1])])
        return (most if most <= enough * limit else points.speed(q, velocity)) / limit


class Unlimited:
    """Uses every target as the goal, without limits; the robot's controller may stop the arm for it."""

    def __init__(self) -> None:
        self.reset(np.zeros(7))

    def carry(self, balls: Iterable[Ball]) -> None:
        """Does nothing: no speed is limited."""

    def reset(self, q: np.ndarray) -> None:
        self._q = read_only(q)

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._q

    @property
    def at_rest(self) -> bool:
        return True

    def brake(self, dt: float) -> LimitedGoal:
        return LimitedGoal(self._q, np.zeros(7), None)

    def step(
        self,
        target: np.ndarray,
        measured: np.ndarray,
        dt: float,
        scale: float = 1.0,
        speed: np.ndarray | None = None,
        cap: float = 1.0,
    ) -> LimitedGoal:
        """Returns the target; the arguments are those of `MotionLimits.step`."""
        self._q = read_only(target)
        return LimitedGoal(self._q, np.zeros(7), None)
