"""Changes of the joint velocities within limits of acceleration and jerk, by Ruckig; and the guard of what comes
after. The guard takes a step only if all joints could then still stop: inside their ranges, with the tool inside the
workspace, no point of the arm above its speed limit, and no bodies nearer to each other than their margin on the
way. That stop is always the next step that is left, so the limits hold by induction."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from common.limits import Limit
from kuka_control.limits.moving_arm import STOPPING, JointState, MovingPoints, ShapeLimits
from kuka_control.model.workspace import Workspace
from kuka_control.numbers import SLACK_M

if TYPE_CHECKING:  # without a collision guard its library is not loaded
    from kuka_control.limits.collision import CollisionGuard

EVEN_S = 0.012  # least duration of a velocity change [s]
SLACK_RAD = 1e-9  # rounding error of a stop that ends at a joint limit [rad]
INWARD_PER_S = 40.0  # gain on the distance between a bound and a tool that slides along it [1/s]


class SpeedChange:
    """Changes the joint velocities within the limits `shape`."""

    def __init__(self, shape: ShapeLimits) -> None:
        self._acceleration = shape.acceleration.tolist()
        self._jerk = shape.jerk.tolist()
        self._ruckig = Ruckig(7)
        self._trajectory = Trajectory(7)
        self._change = InputParameter(7)
        self._stop = InputParameter(7)
        for plan in (self._change, self._stop):
            plan.control_interface = ControlInterface.Velocity
            plan.max_acceleration = self._acceleration
            plan.max_jerk = self._jerk
        self._change.minimum_duration = EVEN_S
        # Each joint as quickly as it can: the rest of such a stop is the stop from any state on its way.
        self._stop.synchronization = Synchronization.No

    def step(self, now: JointState, desired: Sequence[float], dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the velocities `desired`, 7 [rad/s], all in step."""
        self._change.target_velocity = desired
        try:
            trajectory = self._plan(self._change, now)
        except RuckigError:  # rounding may close every way of a least duration: a stop is always there
            return self.stop(now, dt)
        q, v, a = trajectory.at_time(dt)
        return JointState(q, v, a, trajectory.duration)

    def stop(self, now: JointState, dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the earliest stop of each joint."""
        trajectory = self.stopping(now)
        q, v, a = trajectory.at_time(dt)
        return JointState(q, v, a, trajectory.duration)

    def stopping(self, now: JointState) -> Trajectory:
        """Returns the path to the earliest stop of each joint; it is valid until the next call of this object."""
        return self._plan(self._stop, now)

    def stopping_bounds(self, now: JointState) -> tuple[list[float], list[float]]:
        """Returns bounds of each joint's speed [rad/s] and path length [rad] on the way to its earliest stop. An
        acceleration a that must first go to zero at the jerk j adds a^2 / 2j to the speed and takes a / j; the stop
        from a speed v then takes v / a_max + a_max / j at most, at v / 2 in the mean."""
        speeds, lengths = [], []
        for v, a, most, jerk in zip(now.v, now.a, self._acceleration, self._jerk):
            rise = abs(a) / jerk
            speed = abs(v) + 0.5 * abs(a) * rise
            speeds.append(speed)
            lengths.append(speed * (rise + 0.5 * (speed / most + most / jerk)))
        return speeds, lengths

    def _plan(self, plan: InputParameter, now: JointState) -> Trajectory:
        plan.current_position, plan.current_velocity = now.q, now.v
        plan.current_acceleration = [min(max(a, -most), most) for a, most in zip(now.a, self._acceleration)]
        self._ruckig.calculate(plan, self._trajectory)
        return self._trajectory


@dataclass(frozen=True)
class GuardedRoom:
    lower: np.ndarray  # joint ranges, shape (7,) [rad]
    upper: np.ndarray
    speed: float  # of every point of the moving arm [m/s]
    points: MovingPoints
    tool_jacobian: Callable[[np.ndarray], np.ndarray] | None = None  # of the tool point, shape (6, 7), at joints (7,)
    workspace: Workspace | None = None  # of the tool point; with a Jacobian
    collisions: CollisionGuard | None = None  # the bodies that keep a distance


@dataclass(frozen=True)
class _Stop:
    """What the stop from a state leads to: the arm's greatest speed [m/s], the tool's distance outside the workspace
    [m], and how far which pairs of bodies come within their margin [m]."""

    speed: float
    outside: float
    depths: dict[int, float] = field(default_factory=dict)

    def within(self, other: _Stop) -> bool:
        return self.speed <= other.speed and self.outside <= other.outside and self.apart(other)

    def apart(self, other: _Stop) -> bool:
        return all(depth <= other.depths.get(pair, 0.0) for pair, depth in self.depths.items())


class StoppingGuard:
    """Limits each step so that the arm can still stop within bounds; changes the desired velocity as little as
    possible.

    A joint that could not stop within its range brakes by itself. At a bound of the workspace the tool slides: only
    what carries it out is removed, by a motion that keeps the other directions and the orientation. If that is not
    enough, the arm gets too fast, or bodies would come nearer than their margin, the rest is scaled down.
    `acceleration`: of each joint when it brakes, shape (7,) [rad/s^2]."""

    def __init__(self, change: SpeedChange, room: GuardedRoom, acceleration: np.ndarray) -> None:
        self._change = change
        self._room = room
        self._acceleration = acceleration
        self._allowed = _Stop(room.speed, SLACK_M)
        self._ranges = list(zip(room.lower.tolist(), room.upper.tolist()))

    def step(self, now: JointState, desired: Sequence[float], dt: float) -> tuple[JointState, Limit | None]:
        """Returns the state after dt [s], and what held the desired velocities, 7 [rad/s], back."""
        halvings = 5  # bisections of the fraction of the desired velocity that can be kept
        free = self._change.step(now, desired, dt)
        beyond: list[int] = []
        if self._far_from_bounds(free):
            if not self._depths(free):
                return free, None
        else:
            stop, beyond = self._stop(free)
            if not beyond and stop.within(self._allowed):
                return free, None
        braking = self._change.stop(now, dt)
        held = Limit.JOINT_RANGE if beyond else None
        best, stop = self._ranged(free, braking)
        # An arm that can no longer stop within bounds may take any step that is no worse than a full stop.
        least, _ = self._stop(braking)
        bound = _Stop(max(self._allowed.speed, least.speed), max(self._allowed.outside, least.outside), least.depths)
        if stop.within(bound):
            return best, held
        kept, given_up, best = [0.0] * 7, desired, braking
        if stop.outside > bound.outside:
            held = Limit.WORKSPACE
            along = self.along(np.array(now.q), np.array(desired)).tolist()
            state, stop = self._ranged(self._change.step(now, along, dt), braking)
            if stop.within(bound):
                kept, best = along, state
            else:
                given_up = along
        elif not stop.apart(bound):
            held = Limit.COLLISION_GUARD
        for _ in range(halvings):
            middle = [0.5 * (a + b) for a, b in zip(kept, given_up)]
            state, stop = self._ranged(self._change.step(now, middle, dt), braking)
            if stop.within(bound):
                kept, best = middle, state
            else:
                given_up = middle
        return best, held or Limit.ARM_SPEED

    def along(self, q: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Returns the joint velocities without what carries the tool beyond a bound; shape (7,) [rad/s], at q [rad]."""
        # passes over the bounds: a correction at one may add speed across another (they meet at 68 deg or more)
        sweeps = 5
        # of the pseudoinverse, in the tool's deceleration [m/s^2], [rad/s^2]; it matters near singular poses
        damping = 0.05
        # least fraction of the desired velocity after damping: a stretched arm cannot move outward at all
        least = 1e-6
        room = self._room
        assert room.workspace is not None and room.tool_jacobian is not None, "only a workspace has bounds"
        position, J = np.array(list(room.points.tool_point(q.tolist())[0])), room.tool_jacobian(q)
        normals = room.workspace.outward(position)
        # In units of each joint's deceleration, so that the strong joints move most.
        strong = J * self._acceleration
        outward_motions = np.concatenate([normals.T, np.zeros((3, len(normals)))])
        corrections = strong.T @ np.linalg.solve(strong @ strong.T + damping**2 * np.eye(6), outward_motions)
        corrections *= self._acceleration[:, None] / np.maximum(
            np.sum(normals.T * (strong[:3] @ corrections), axis=0), least
        )
        left = desired
        for _ in range(sweeps):
            for normal, column, distance in zip(normals, corrections.T, room.workspace.rooms(position)):
                excess = float(normal @ J[:3] @ left) - INWARD_PER_S * distance
                left = left - max(excess, 0.0) * column
        # Near a singular pose this may need fast joints; none may be faster than in the desired velocity.
        pace, allowed = (float(np.max(np.abs(v) / self._acceleration)) for v in (left, desired))
        return left if pace <= allowed else allowed / pace * left

    def _far_from_bounds(self, state: JointState) -> bool:
        """Returns True only if the stop from a state keeps all bounds but those of the collision guard, by
        estimates. They cost less than the stop. On the way no point is further from a joint's axis than now, plus
        the path length on which the joints after it carry the point."""
        quick = 0.999  # fraction of the speed limit up to which an upper bound of the speed replaces that check
        room = self._room
        speeds, lengths = self._change.stopping_bounds(state)
        for angle, length, (lower, upper) in zip(state.q, lengths, self._ranges):
            if not (angle + length <= upper and angle - length >= lower):
                return False
        position, reaches = room.points.tool_point(state.q)
        fastest = path = 0.0
        for i in (6, 5, 4, 3, 2, 1, 0):
            reach = reaches[i] + path
            fastest += speeds[i] * reach
            path += lengths[i] * reach
        limit = quick * room.speed
        if not (fastest <= limit or self._fastest(state, speeds, lengths, path) <= limit):
            return False
        return room.workspace is None or path <= min(room.workspace.rooms(position))

    def _fastest(self, state: JointState, speeds: list[float], lengths: list[float], path: float) -> float:
        """Returns a closer bound of the arm's speed on the way to the stop from a state [m/s].

        Where each joint i has a part s_i, 0 to 1, of its velocity left, a point moves at |sum s_i u_i|, at most half of
        |sum u_i| + sum |u_i|. On top comes what an acceleration adds first, and what the turns change.

        `speeds`, `lengths`: as `SpeedChange.stopping_bounds`; `path`: of a point at most [m]."""
        points = self._room.points
        fastest, turned, others = 0.5 * points.speed(state.q, state.v), 0.0, 0.0
        for v, speed, length, reach in zip(state.v, speeds, lengths, points.tool_point(state.q)[1]):
            turned += length
            fastest += (reach + path) * (speed + 0.5 * (speed * turned + length * others - abs(v)))
            others += speed
        return fastest

    def _depths(self, state: JointState) -> dict[int, float]:
        """Returns how far which pairs of bodies come within their margin on the way to the stop from a state [m]."""
        collisions = self._room.collisions
        if collisions is None:
            return {}
        near = collisions.near(state.q, self._change.stopping_bounds(state)[1])
        return collisions.depths(self._change.stopping(state), near) if near else {}

    def _ranged(self, state: JointState, braking: JointState) -> tuple[JointState, _Stop]:
        """Returns the state with the joints that could not stop in their ranges braking instead, and its stop."""
        stop, beyond = self._stop(state)
        if beyond:
            columns = zip((state.q, state.v, state.a), (braking.q, braking.v, braking.a))
            q, v, a = ([b[i] if i in beyond else s[i] for i in range(7)] for s, b in columns)
            state = JointState(q, v, a, state.duration)
            stop, _ = self._stop(state)
        return state, stop

    def _stop(self, state: JointState) -> tuple[_Stop, list[int]]:
        """Returns what the stop from a state leads to, and the joints that it carries out of their ranges."""
        fastest = 3  # at so many of them, the first ones, the arm's speed is checked too: later it mostly falls
        near_limit = 0.85  # a speed above this fraction of the limit is checked at more of them:
        more = (0.02, 0.05, 0.15, 0.2, 0.4, 0.5)
        room = self._room
        path = self._change.stopping(state)
        ends = path.at_time(path.duration)[0]
        beyond = [
            i
            for i, (end, (lower, upper)) in enumerate(zip(ends, self._ranges))
            if (end > upper + SLACK_RAD and state.v[i] > 0.0) or (end < lower - SLACK_RAD and state.v[i] < 0.0)
        ]
        speed, outside = 0.0, -math.inf
        for i, fraction in enumerate(STOPPING):
            q, v, _ = path.at_time(fraction * path.duration)
            if room.workspace is not None:
                outside = max(outside, -min(room.workspace.rooms(room.points.tool_point(q)[0])))
            if i < fastest:
                speed = max(speed, room.points.speed(q, v))
        if speed > near_limit * room.speed:
            for fraction in more:
                speed = max(speed, room.points.speed(*path.at_time(fraction * path.duration)[:2]))
        return _Stop(speed, outside, self._depths(state)), beyond
