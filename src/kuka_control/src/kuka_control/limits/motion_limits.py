"""Servo goals within limits of speed, acceleration and jerk: the motion of the goal in one cycle.

First the desired velocity: that of the target plus a correction of the distance to it, no faster than the joints can
brake before the target. One factor scales all joints down to what the joint speeds, the tool speed and the lag of the
arm allow, so that the path stays straight. Then Ruckig changes the present velocity into the desired one within the
limits of acceleration and jerk, evenly over a few cycles where it can.

A target that moves steadily within the limits is met without lag. Velocities change in a straight line from one allowed
velocity to the next. The guard (speed_change.py) takes a step only if the arm could then still stop in time.

Near a singular pose the joints would have to race: there the slowest joint sets the pace of all, on the way in and on
the way out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.limits.speed_change import GuardedRoom, JointState, ShapeLimits, SpeedChange, StoppingGuard

GAIN_PER_S = 40.0  # gain on a small distance between goal and target [1/s]
LATE_S = 0.04  # if a velocity change takes longer than this, the limits of acceleration and jerk hold the goal back [s]
BRAKING_FRACTION = 0.4  # of the acceleration limit, with which braking is planned; the jerk limit costs the rest
GAP_S = 0.03  # after a longer gap than this between two goals the arm stands at the last one, and starts from rest [s]
ARM_S = 0.03  # expected lag of an arm whose drives have a time constant of 40 ms [s]
LEAD_RAD = (0.035, 0.065)
"""Excess lag of the arm at which the goal begins to slow down, and at which it waits [rad].

The toolbox's servo law hardly speeds up for a more distant goal (docs/handbook/wire-protocols.md, "Servo mode"), and an
arm that catches up such a lag is too fast when its target slows down."""

LOOK_AHEAD_S = 0.005  # the tool speed is averaged over this time [s]
LEAST_USED = 1e-9  # fraction of a speed limit below which nothing moves
AT_REST_RAD = 1e-7
AT_REST_RAD_S = 1e-4  # a goal this close to a resting target, and this slow, is set to the target


@dataclass(frozen=True)
class LimitedGoal:
    """A servo goal: joints [rad] and their velocities [rad/s], shape (7,) each."""

    q: np.ndarray
    v: np.ndarray
    limited_by: str | None
    """What holds the goal back: "joint speed", "tool speed", "frame rate", "joint acceleration", "joint limit", "lag of
    the arm", "workspace" or "gap between goals"; None if it moves with the desired velocity."""


class MotionLimits:
    """Follows a moving target within the limits.

    Args:
        joint_speeds: speed limits of the joints, shape (7,) [rad/s].
        shape: limits of acceleration and jerk.
        room: the joint ranges and the workspace that no goal leaves, and the speed limit of the tool.
    """

    def __init__(self, joint_speeds: np.ndarray, shape: ShapeLimits, room: GuardedRoom) -> None:
        self._joint_speeds = joint_speeds
        self._room = room
        self._braking = BRAKING_FRACTION * shape.acceleration
        self._linear = self._braking / GAIN_PER_S**2
        self._change = SpeedChange(shape)
        self._guard = StoppingGuard(self._change, room, shape.acceleration)
        self._slow = False  # whether the last goal came after a gap
        self.reset(np.zeros(7))

    def reset(self, q: np.ndarray) -> None:
        """Starts from the joints q, at rest."""
        self._now = JointState.rest(read_only(q))

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._now.q

    @property
    def at_rest(self) -> bool:
        """Whether the goal has no speed and no acceleration."""
        return not (np.any(self._now.v) or np.any(self._now.a))

    def brake(self, dt: float) -> LimitedGoal:
        """Returns the goal after the next `dt` seconds on the way to the earliest stop within the limits."""
        dt = self._after(dt)
        stopped = self._change.stop(self._now, dt)
        at_rest = stopped.duration <= dt
        self._now = JointState.rest(stopped.q) if at_rest else stopped
        return LimitedGoal(read_only(self._now.q), read_only(self._now.v), None)

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
            cap: upper bound of the scaling factor, [0, 1], also for what the target needs by itself.
        """
        gap = "gap between goals" if dt > GAP_S else None
        dt = self._after(dt)
        speed = np.zeros(7) if speed is None else speed
        q, v = self._now.q, self._now.v
        error = target - q - dt * v
        at_rest = not np.any(speed) and np.max(np.abs(v)) < AT_REST_RAD_S
        if at_rest and np.max(np.abs(target - q)) < AT_REST_RAD:
            self.reset(target)
            return LimitedGoal(self._now.q, read_only(self._now.v), None)
        desired, held_by = self._desired_velocity(error, speed)
        if scale < 1.0:
            scale = min(1.0, max(scale, max(self._used(speed)) + 0.5 * scale))
        allowed, limited_by = self._allowed(desired, measured, min(scale, cap))
        if cap < scale and limited_by in ("joint speed", "tool speed"):
            limited_by = "frame rate"
        down, up = self._speed_within(np.array((q - self._room.lower, self._room.upper - q)))
        within = np.clip(allowed, -down, up)
        if np.max(np.abs(within - allowed)) > AT_REST_RAD_S:
            limited_by = limited_by or "joint limit"
        self._now, held = self._guard.step(self._now, within, dt)
        late = "joint acceleration" if self._now.duration > LATE_S else None
        return LimitedGoal(read_only(self._now.q), read_only(self._now.v), gap or held or limited_by or held_by or late)

    def _after(self, dt: float) -> float:
        """Returns the time that the goal moves on [s]; after a gap it rests first where it is.

        Where one gap follows the other it moves on from rest, so that a slow link or machine does not stop the arm.
        """
        slow, self._slow = self._slow, dt > GAP_S
        if not self._slow:
            return max(dt, 0.0)
        self.reset(self._now.q)
        return GAP_S if slow else 0.0

    def _speed_within(self, room: np.ndarray) -> np.ndarray:
        """Returns the speeds from which the joints can brake within distances, shape (n, 7) [rad]."""
        room = np.maximum(room, 0.0)
        fast = np.sqrt(2.0 * self._braking * np.maximum(room - 0.5 * self._linear, 0.0))
        return np.where(room <= self._linear, GAIN_PER_S * room, fast)

    def _desired_velocity(self, error: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, str | None]:
        """Returns the desired velocity, and "joint acceleration" if braking before the target limits it."""
        # In units of what each joint brakes with, distances are squares of times.
        far = float(np.max(np.abs(error) / self._braking))
        linear = 1.0 / GAIN_PER_S**2
        if far <= linear:
            return speed + GAIN_PER_S * error, None
        return speed + (np.sqrt(2.0 * far - linear) / far) * error, "joint acceleration"

    def _allowed(self, desired: np.ndarray, measured: np.ndarray, scale: float) -> tuple[np.ndarray, str | None]:
        """Returns the desired velocity scaled down to the limits, and the limit that scales it down most."""
        fastest, tool = self._used(desired)
        factor, limited_by = scale / max(fastest, tool, scale, LEAST_USED), None
        if factor < 1.0:
            limited_by = "joint speed" if fastest > tool else "tool speed"
        desired = factor * desired
        begin, end = LEAD_RAD
        behind = np.sign(desired) * (self._now.q - measured) - ARM_S * np.abs(desired)
        room = (end - float(np.max(behind[desired != 0.0], initial=0.0))) / (end - begin)
        if room >= 1.0:
            return desired, limited_by
        return max(room, 0.0) * desired, "lag of the arm"

    def _used(self, speed: np.ndarray) -> tuple[float, float]:
        """Returns the fractions of the joint speed limits and of the tool speed limit that a velocity uses."""
        position = self._room.tool_position
        path = math.dist(position(self._now.q + LOOK_AHEAD_S * speed), position(self._now.q))
        return float(np.max(np.abs(speed) / self._joint_speeds)), path / (LOOK_AHEAD_S * self._room.tool_speed)


class Unlimited:
    """Uses every target as the goal, without limits; the robot's controller may stop the arm for it."""

    def __init__(self) -> None:
        self.reset(np.zeros(7))

    def reset(self, q: np.ndarray) -> None:
        """Starts from the joints q."""
        self._q = read_only(q)

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._q

    @property
    def at_rest(self) -> bool:
        """Returns True: each goal stands by itself."""
        return True

    def brake(self, dt: float) -> LimitedGoal:
        """Returns the last goal."""
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
