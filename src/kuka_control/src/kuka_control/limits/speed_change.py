"""Changes of the joint velocities within limits of acceleration and jerk, by Ruckig; and the guard of what comes after.

The guard takes a step only if all joints could then still stop: inside their ranges, with the tool inside the workspace
and below its speed limit on the way. That stop is always the next step that is left, so the limits hold by induction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from kuka_control.model.workspace import Workspace

EVEN_S = 0.012  # least duration of a velocity change [s]
STOPPING = (0.0, 0.1, 0.3, 0.6, 1.0)  # fractions of the stopping time at which the position of the tool is checked
FASTEST = 3  # at so many of them, the first ones, its speed is checked too: later it mostly falls
NEAR_LIMIT = 0.85  # a speed above this fraction of the limit is checked at more of them:
MORE = (0.02, 0.05, 0.15, 0.2, 0.4, 0.5)
DIFFERENCE_S = 1e-4  # time over which that speed is calculated [s]
SLACK_M = 1e-3  # the path to a stop may lead out of the workspace by this much: at curved bounds it is straight [m]
SLACK_RAD = 1e-9  # rounding error of a stop that ends at a joint limit [rad]
INWARD_PER_S = 40.0  # gain on the distance between a bound and a tool that slides along it [1/s]
HALVINGS = 5  # bisections of the fraction of the desired velocity that can be kept
SWEEPS = 5  # passes over the bounds: a correction at one may add speed across another (they meet at 68 deg or more)
DAMPING = 0.05  # of the pseudoinverse, in the tool's deceleration [m/s^2], [rad/s^2]; it matters near singular poses
LEAST = 1e-6  # least fraction of the desired velocity after damping: a stretched arm cannot move outward at all


@dataclass(frozen=True)
class ShapeLimits:
    """How quickly each joint may change its speed, shape (7,): acceleration [rad/s^2] and jerk [rad/s^3]."""

    acceleration: np.ndarray
    jerk: np.ndarray


@dataclass(frozen=True)
class JointState:
    """Joint angles [rad], velocities [rad/s] and accelerations [rad/s^2], shape (7,) each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    duration: float = 0.0  # of the whole velocity change [s]

    @classmethod
    def rest(cls, q: np.ndarray) -> JointState:
        """Returns the state at rest at joints q."""
        return cls(q, np.zeros(7), np.zeros(7))


class SpeedChange:
    """Changes the joint velocities within the limits `shape`."""

    def __init__(self, shape: ShapeLimits) -> None:
        self._acceleration = shape.acceleration
        self._ruckig = Ruckig(7)
        self._trajectory = Trajectory(7)
        self._change, self._stop = InputParameter(7), InputParameter(7)
        for plan in (self._change, self._stop):
            plan.control_interface = ControlInterface.Velocity
            plan.max_acceleration = shape.acceleration.tolist()
            plan.max_jerk = shape.jerk.tolist()
        self._change.minimum_duration = EVEN_S
        # Each joint as quickly as it can: the rest of such a stop is the stop from any state on its way.
        self._stop.synchronization = Synchronization.No

    def step(self, now: JointState, desired: np.ndarray, dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the velocities `desired`, shape (7,) [rad/s], all in step."""
        self._change.target_velocity = desired.tolist()
        try:
            trajectory = self._plan(self._change, now)
        except RuckigError:  # rounding may close every way of a least duration: a stop is always there
            return self.stop(now, dt)
        q, v, a = (np.array(values) for values in trajectory.at_time(dt))
        return JointState(q, v, a, trajectory.duration)

    def stop(self, now: JointState, dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the earliest stop of each joint."""
        trajectory = self.stopping(now)
        q, v, a = (np.array(values) for values in trajectory.at_time(dt))
        return JointState(q, v, a, trajectory.duration)

    def stopping(self, now: JointState) -> Trajectory:
        """Returns the path to the earliest stop of each joint; it is valid until the next call of this object."""
        return self._plan(self._stop, now)

    def _plan(self, plan: InputParameter, now: JointState) -> Trajectory:
        plan.current_position, plan.current_velocity = now.q.tolist(), now.v.tolist()
        plan.current_acceleration = np.clip(now.a, -self._acceleration, self._acceleration).tolist()
        self._ruckig.calculate(plan, self._trajectory)
        return self._trajectory


@dataclass(frozen=True)
class GuardedRoom:
    """What the guard keeps to."""

    lower: np.ndarray  # joint ranges, shape (7,) [rad]
    upper: np.ndarray
    tool_speed: float  # of the tool point [m/s]
    tool_position: Callable[[ArrayLike], np.ndarray]  # of the tool point, shape (3,) [m], at joints, shape (7,) [rad]
    tool_jacobian: Callable[[np.ndarray], np.ndarray] | None = None  # of the tool point, shape (6, 7), likewise
    workspace: Workspace | None = None  # of the tool point; with a Jacobian


@dataclass(frozen=True)
class _Stop:
    """What the stop from a state leads to: the tool's greatest speed [m/s] and distance outside the workspace [m]."""

    speed: float
    outside: float

    def within(self, other: _Stop) -> bool:
        return self.speed <= other.speed and self.outside <= other.outside


class StoppingGuard:
    """Limits each step so that the arm can still stop within bounds.

    A step that keeps them is not changed. Otherwise the guard changes the desired velocity as little as possible. A
    joint that could not stop within its range brakes by itself. At a bound of the workspace the guard removes the part
    that carries the tool out, by a motion that changes neither the other directions nor the orientation of the tool, so
    that the tool slides along the bound. If that is not enough, or the tool gets too fast, it scales the rest down.

    Args:
        change: of the velocities.
        room: what is kept to.
        acceleration: deceleration of each joint when it brakes, shape (7,) [rad/s^2].
    """

    def __init__(self, change: SpeedChange, room: GuardedRoom, acceleration: np.ndarray) -> None:
        self._change = change
        self._room = room
        self._acceleration = acceleration
        self._allowed = _Stop(room.tool_speed, SLACK_M)
        self._ranges = list(zip(room.lower.tolist(), room.upper.tolist()))

    def step(self, now: JointState, desired: np.ndarray, dt: float) -> tuple[JointState, str | None]:
        """Returns the state after dt [s], and what held the desired velocities, (7,) [rad/s], back."""
        free = self._change.step(now, desired, dt)
        stop, beyond = self._stop(free)
        if not beyond and stop.within(self._allowed):
            return free, None
        braking = self._change.stop(now, dt)
        held = "joint limit" if beyond else None
        best, stop = self._ranged(free, braking)
        # An arm that can no longer stop within bounds may take any step that is no worse than a full stop.
        least, _ = self._stop(braking)
        bound = _Stop(max(self._allowed.speed, least.speed), max(self._allowed.outside, least.outside))
        if stop.within(bound):
            return best, held
        kept, given_up, best = np.zeros(7), desired, braking
        if stop.outside > bound.outside:
            held = "workspace"
            along = self.along(now.q, desired)
            state, stop = self._ranged(self._change.step(now, along, dt), braking)
            if stop.within(bound):
                kept, best = along, state
            else:
                given_up = along
        for _ in range(HALVINGS):
            middle = 0.5 * (kept + given_up)
            state, stop = self._ranged(self._change.step(now, middle, dt), braking)
            if stop.within(bound):
                kept, best = middle, state
            else:
                given_up = middle
        return best, held or "tool speed"

    def along(self, q: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Returns the joint velocities without what carries the tool beyond a bound; shape (7,) [rad/s], at q [rad]."""
        room = self._room
        assert room.workspace is not None and room.tool_jacobian is not None, "only a workspace has bounds"
        position, J = room.tool_position(q), room.tool_jacobian(q)
        normals = room.workspace.outward(position)
        # In units of each joint's deceleration, so that the strong joints move most.
        strong = J * self._acceleration
        outward_motions = np.concatenate([normals.T, np.zeros((3, len(normals)))])
        corrections = strong.T @ np.linalg.solve(strong @ strong.T + DAMPING**2 * np.eye(6), outward_motions)
        corrections *= self._acceleration[:, None] / np.maximum(
            np.sum(normals.T * (strong[:3] @ corrections), axis=0), LEAST
        )
        left = desired
        for _ in range(SWEEPS):
            for normal, column, distance in zip(normals, corrections.T, room.workspace.rooms(position)):
                excess = float(normal @ J[:3] @ left) - INWARD_PER_S * distance
                left = left - max(excess, 0.0) * column
        # Near a singular pose this may need fast joints; none may be faster than in the desired velocity.
        pace, allowed = (float(np.max(np.abs(v) / self._acceleration)) for v in (left, desired))
        return left if pace <= allowed else allowed / pace * left

    def _ranged(self, state: JointState, braking: JointState) -> tuple[JointState, _Stop]:
        """Returns the state with the joints that could not stop in their ranges braking instead, and its stop."""
        stop, beyond = self._stop(state)
        if beyond:
            for i in beyond:
                state.q[i], state.v[i], state.a[i] = braking.q[i], braking.v[i], braking.a[i]
            stop, _ = self._stop(state)
        return state, stop

    def _stop(self, state: JointState) -> tuple[_Stop, list[int]]:
        """Returns what the stop from a state leads to, and the joints that it carries out of their ranges."""
        room = self._room
        path = self._change.stopping(state)
        ends = path.at_time(path.duration)[0]
        beyond = [
            i
            for i, (end, (lower, upper)) in enumerate(zip(ends, self._ranges))
            if (end > upper + SLACK_RAD and state.v[i] > 0.0) or (end < lower - SLACK_RAD and state.v[i] < 0.0)
        ]
        positions = []
        speed = 0.0
        for i, fraction in enumerate(STOPPING):
            q, v, _ = path.at_time(fraction * path.duration)
            positions.append(room.tool_position(q))
            if i < FASTEST:
                speed = max(speed, self._speed(q, v, positions[-1]))
        if speed > NEAR_LIMIT * room.tool_speed:
            for fraction in MORE:
                q, v, _ = path.at_time(fraction * path.duration)
                speed = max(speed, self._speed(q, v, room.tool_position(q)))
        if room.workspace is None:
            return _Stop(speed, -math.inf), beyond
        return _Stop(speed, -min(min(room.workspace.rooms(position)) for position in positions)), beyond

    def _speed(self, q: list[float], v: list[float], position: np.ndarray) -> float:
        """Returns the speed of the tool [m/s] at a position [m], the one at joints q [rad], for joint speeds v."""
        ahead = self._room.tool_position([angle + DIFFERENCE_S * rate for angle, rate in zip(q, v)])
        return math.dist(ahead, position) / DIFFERENCE_S
