"""Servo goals within limits of speed, acceleration and jerk: where the goal goes in one cycle.

Two steps. A wish: the speed at which the goal meets its target, that of the target itself and what makes up for the
distance, no faster than can be braked before the target. The whole wish, all joints by one factor, is slowed down to
what the joints, the tool and the lag of the arm allow, so that the way stays straight. Then Ruckig turns the present
speed into the wished one within the limits of acceleration and jerk; it does so evenly over a few cycles where it can.

A target that moves steadily within the limits is met without lag. Since speeds go straight from one allowed wish to the
next, the speed of the tool stays below its limit on the way too.

With a tool near a singular pose the joints would have to race; here the slowest joint sets the pace of all, and the
way back out is as free as the way in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.limits.speed_change import JointState, ShapeLimits, SpeedChange
from kuka_control.limits.workspace_brake import WorkspaceBrake

GAIN_PER_S = 40.0
"""The goal makes up for a small distance to its target with this share of it per second."""

LATE_S = 0.04
"""A change of speed that takes longer than this is held back by the limits of acceleration and jerk [s]."""

BRAKING_SHARE = 0.4
"""Braking before the target is planned with this share of the acceleration; the rest is for what jerk limits cost."""

MAX_CYCLE_S = 0.012
"""No cycle counts for longer, so that a stall of the loop is not made up for [s]."""

ARM_S = 0.03
"""An arm with drives of 40 ms is about this far behind its goal [s]."""

LEAD_RAD = (0.035, 0.065)
"""Lag of the arm [rad] from which on the goal slows down, and at which it waits.

The toolbox's servo law hardly speeds up for a more distant goal (docs/handbook/wire-protocols.md, "Servo mode"), and an
arm that has to make up such a lag is too fast when its target slows down."""

LOOK_AHEAD_S = 0.005
"""The speed of the tool is taken over the way of this time [s]."""

AT_REST_RAD = 1e-6
AT_REST_RAD_S = 1e-4
"""A goal this close to a target at rest, and this slow, stands on it."""


@dataclass(frozen=True)
class SpeedLimits:
    """Greatest speeds of the stream: of each joint, shape (7,) [rad/s], and of the tool point [m/s]."""

    joints: np.ndarray
    tool: float


@dataclass(frozen=True)
class LimitedGoal:
    """A servo goal.

    Attributes:
        q: the goal, shape (7,) [rad].
        v: its speed, shape (7,) [rad/s].
        limited_by: "joint speed", "tool speed", "joint acceleration", "joint limit", "lag of the arm" or "workspace",
            what holds the goal back; None while it meets its target as it wishes.
    """

    q: np.ndarray
    v: np.ndarray
    limited_by: str | None


class MotionLimits:
    """Follows a moving target within the limits.

    Args:
        speeds: the speed limits.
        shape: limits of acceleration and jerk.
        lower, upper: joint ranges, shape (7,) [rad], that no goal leaves.
        tool_position: position of the tool point [m], shape (3,), at joints q.
        brake: keeps the tool inside the workspace; where left out, nothing does but the target.
    """

    def __init__(
        self,
        speeds: SpeedLimits,
        shape: ShapeLimits,
        lower: np.ndarray,
        upper: np.ndarray,
        tool_position: Callable[[np.ndarray], np.ndarray],
        brake: WorkspaceBrake | None = None,
    ) -> None:
        self._speeds = speeds
        self._lower = lower
        self._upper = upper
        self._braking = BRAKING_SHARE * shape.acceleration
        self._tool_position = tool_position
        self._brake = brake
        self._change = SpeedChange(shape, lower, upper)
        self.reset(np.zeros(7))

    def reset(self, q: np.ndarray) -> None:
        """Starts from the joints q, at rest."""
        self._now = JointState(read_only(q), np.zeros(7), np.zeros(7))

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._now.q

    def step(
        self, target: np.ndarray, measured: np.ndarray, dt: float, share: float = 1.0, speed: np.ndarray | None = None
    ) -> LimitedGoal:
        """Returns the goal after the next `dt` seconds.

        Args:
            target: joints to be met then, shape (7,) [rad].
            measured: joints of the arm, shape (7,) [rad].
            dt: time since the last call [s].
            share: of the speed limits that counts now, (0, 1]; a target that is faster itself is approached with
                half of that share besides.
            speed: of the target, shape (7,) [rad/s]; at rest where left out.
        """
        dt = min(max(dt, 0.0), MAX_CYCLE_S)
        speed = np.zeros(7) if speed is None else speed
        q, v = self._now.q, self._now.v
        error = target - q - dt * v
        at_rest = not np.any(speed) and np.max(np.abs(v)) < AT_REST_RAD_S
        if at_rest and np.max(np.abs(target - q)) < AT_REST_RAD:
            self.reset(target)
            return LimitedGoal(self._now.q, read_only(self._now.v), None)
        wish, held_by = self._wish(error, speed)
        if share < 1.0:
            share = min(1.0, max(share, max(self._used(speed)) + 0.5 * share))
        allowed, limited_by = self._allowed(wish, measured, share)
        within = np.clip(allowed, -self._speed_within(q - self._lower), self._speed_within(self._upper - q))
        if np.max(np.abs(within - allowed)) > AT_REST_RAD_S:
            limited_by = limited_by or "joint limit"
        if self._approach(within, dt):
            limited_by = "workspace"
        late = "joint acceleration" if self._now.duration > LATE_S else None
        return LimitedGoal(self._now.q, read_only(self._now.v), limited_by or held_by or late)

    def _speed_within(self, room: np.ndarray) -> np.ndarray:
        """Returns the speeds that can be braked within a room, shape (7,) [rad]."""
        room = np.maximum(room, 0.0)
        linear = self._braking / GAIN_PER_S**2
        fast = np.sqrt(2.0 * self._braking * np.maximum(room - 0.5 * linear, 0.0))
        return np.where(room <= linear, GAIN_PER_S * room, fast)

    def _wish(self, error: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, str | None]:
        """Returns the speed at which the target is met, and "joint acceleration" if braking in time holds it down."""
        # In units of what each joint brakes with, distances are squares of times.
        far = float(np.max(np.abs(error) / self._braking))
        linear = 1.0 / GAIN_PER_S**2
        if far <= linear:
            return speed + GAIN_PER_S * error, None
        return speed + (np.sqrt(2.0 * far - linear) / far) * error, "joint acceleration"

    def _allowed(self, wish: np.ndarray, measured: np.ndarray, share: float) -> tuple[np.ndarray, str | None]:
        """Returns the wish slowed down to the limits, and the limit that slows it down most."""
        fastest, tool = (used / share for used in self._used(wish))
        factor, limited_by = min(
            (1.0, None),
            (1.0 / max(fastest, 1.0), "joint speed"),
            (1.0 / max(tool, 1.0), "tool speed"),
            key=lambda candidate: candidate[0],
        )
        begin, end = LEAD_RAD
        behind = np.sign(wish) * (self._now.q - measured) - ARM_S * factor * np.abs(wish)
        room = (end - float(np.max(behind[wish != 0.0], initial=0.0))) / (end - begin)
        if room >= 1.0:
            return factor * wish, limited_by
        return max(room, 0.0) * factor * wish, "lag of the arm"

    def _used(self, speed: np.ndarray) -> tuple[float, float]:
        """Returns the share of the joint speeds, and that of the speed of the tool, that joint speeds amount to."""
        way = self._tool_position(self._now.q + LOOK_AHEAD_S * speed) - self._tool_position(self._now.q)
        joints = float(np.max(np.abs(speed) / self._speeds.joints))
        return joints, float(np.linalg.norm(way)) / (LOOK_AHEAD_S * self._speeds.tool)

    def _approach(self, wish: np.ndarray, dt: float) -> bool:
        """Moves on for dt [s] towards a speed; returns whether the end of the workspace holds that back."""
        if self._brake is None:
            self._now = self._change.step(self._now, wish, dt)
            return False
        self._now, held = self._brake.step(self._change, self._now, wish, dt)
        return held


class Unlimited:
    """Passes every target on as it is, as the original did; the arm may be stopped for it."""

    def __init__(self) -> None:
        self.reset(np.zeros(7))

    def reset(self, q: np.ndarray) -> None:
        """Starts from the joints q."""
        self._q = read_only(q)

    @property
    def goal(self) -> np.ndarray:
        """The last goal, shape (7,) [rad]."""
        return self._q

    def step(
        self, target: np.ndarray, measured: np.ndarray, dt: float, share: float = 1.0, speed: np.ndarray | None = None
    ) -> LimitedGoal:
        """Returns the target; the arguments are those of `MotionLimits.step`."""
        self._q = read_only(target)
        return LimitedGoal(self._q, np.zeros(7), None)
