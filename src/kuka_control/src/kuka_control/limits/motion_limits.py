"""Servo goals within limits of speed, acceleration and jerk: the motion of the goal in one cycle.

First the desired velocity: that of the target plus a correction of the distance to it, no faster than the joints can
brake before the target. One factor scales all joints down to what the joint speeds, the tool speed and the lag of the
arm allow, so that the path stays straight. Then Ruckig changes the present velocity into the desired one within the
limits of acceleration and jerk, evenly over a few cycles where it can.

A target that moves steadily within the limits is met without lag. Velocities change in a straight line from one allowed
velocity to the next, so the tool speed stays below its limit in between.

Near a singular pose the joints would have to race: there the slowest joint sets the pace of all, on the way in and on
the way out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.limits.speed_change import JointState, ShapeLimits, SpeedChange, WorkspaceBrake

GAIN_PER_S = 40.0  # gain on a small distance between goal and target [1/s]
LATE_S = 0.04  # if a velocity change takes longer than this, the limits of acceleration and jerk hold the goal back [s]
BRAKING_FRACTION = 0.4  # of the acceleration limit, with which braking is planned; the jerk limit costs the rest
MAX_CYCLE_S = 0.012  # upper bound of one cycle: after a stall of the loop the goal does not catch up the lost time [s]
ARM_S = 0.03  # expected lag of an arm whose drives have a time constant of 40 ms [s]
LEAD_RAD = (0.035, 0.065)
"""Excess lag of the arm at which the goal begins to slow down, and at which it waits [rad].

The toolbox's servo law hardly speeds up for a more distant goal (docs/handbook/wire-protocols.md, "Servo mode"), and an
arm that catches up such a lag is too fast when its target slows down."""

LOOK_AHEAD_S = 0.005  # the tool speed is averaged over this time [s]
AT_REST_RAD = 1e-6
AT_REST_RAD_S = 1e-4  # a goal this close to a resting target, and this slow, is set to the target


@dataclass(frozen=True)
class SpeedLimits:
    """Greatest speeds of the stream: of each joint, shape (7,) [rad/s], and of the tool point [m/s]."""

    joints: np.ndarray
    tool: float


@dataclass(frozen=True)
class LimitedGoal:
    """A servo goal: joints [rad] and their velocities [rad/s], shape (7,) each."""

    q: np.ndarray
    v: np.ndarray
    limited_by: str | None
    """What holds the goal back: "joint speed", "tool speed", "joint acceleration", "joint limit", "lag of the arm" or
    "workspace"; None if it moves with the desired velocity."""


class MotionLimits:
    """Follows a moving target within the limits.

    Args:
        speeds: the speed limits.
        shape: limits of acceleration and jerk.
        lower, upper: joint ranges, shape (7,) [rad], that no goal leaves.
        tool_position: position of the tool point [m], shape (3,), at joints q.
        brake: keeps the tool inside the workspace; None: only the target does.
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
        self._braking = BRAKING_FRACTION * shape.acceleration
        self._linear = self._braking / GAIN_PER_S**2
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
        self, target: np.ndarray, measured: np.ndarray, dt: float, scale: float = 1.0, speed: np.ndarray | None = None
    ) -> LimitedGoal:
        """Returns the goal after the next `dt` seconds.

        Args:
            target: joints of the target then, shape (7,) [rad].
            measured: joints of the arm, shape (7,) [rad].
            dt: time since the last call [s].
            scale: scaling factor of the speed limits, (0, 1]; a faster target is approached with half of that factor
                on top of its own speed.
            speed: velocity of the target, shape (7,) [rad/s]; None: at rest.
        """
        dt = min(max(dt, 0.0), MAX_CYCLE_S)
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
        allowed, limited_by = self._allowed(desired, measured, scale)
        down, up = self._speed_within(np.array((q - self._lower, self._upper - q)))
        within = np.clip(allowed, -down, up)
        if np.max(np.abs(within - allowed)) > AT_REST_RAD_S:
            limited_by = limited_by or "joint limit"
        if self._approach(within, dt):
            limited_by = "workspace"
        late = "joint acceleration" if self._now.duration > LATE_S else None
        return LimitedGoal(self._now.q, read_only(self._now.v), limited_by or held_by or late)

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
        fastest, tool = (used / scale for used in self._used(desired))
        factor, limited_by = min(
            (1.0, None),
            (1.0 / max(fastest, 1.0), "joint speed"),
            (1.0 / max(tool, 1.0), "tool speed"),
            key=lambda candidate: candidate[0],
        )
        begin, end = LEAD_RAD
        behind = np.sign(desired) * (self._now.q - measured) - ARM_S * factor * np.abs(desired)
        room = (end - float(np.max(behind[desired != 0.0], initial=0.0))) / (end - begin)
        if room >= 1.0:
            return factor * desired, limited_by
        return max(room, 0.0) * factor * desired, "lag of the arm"

    def _used(self, speed: np.ndarray) -> tuple[float, float]:
        """Returns the fractions of the joint speed limits and of the tool speed limit that a velocity uses."""
        path = self._tool_position(self._now.q + LOOK_AHEAD_S * speed) - self._tool_position(self._now.q)
        joints = float(np.max(np.abs(speed) / self._speeds.joints))
        return joints, float(np.linalg.norm(path)) / (LOOK_AHEAD_S * self._speeds.tool)

    def _approach(self, desired: np.ndarray, dt: float) -> bool:
        """Moves the goal for dt [s] towards a velocity; returns whether the end of the workspace holds it back."""
        if self._brake is None:
            self._now = self._change.step(self._now, desired, dt)
            return False
        self._now, held = self._brake.step(self._change, self._now, desired, dt)
        return held


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

    def step(
        self, target: np.ndarray, measured: np.ndarray, dt: float, scale: float = 1.0, speed: np.ndarray | None = None
    ) -> LimitedGoal:
        """Returns the target; the arguments are those of `MotionLimits.step`."""
        self._q = read_only(target)
        return LimitedGoal(self._q, np.zeros(7), None)
