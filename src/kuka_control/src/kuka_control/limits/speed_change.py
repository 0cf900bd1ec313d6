"""Changes of the joint velocities within limits of acceleration and jerk, all joints in step, by Ruckig.

The brake keeps the tool point of the stream of servo goals inside the workspace: it brakes before a bound, not behind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Trajectory

from common.poses import read_only
from kuka_control.model.workspace import Workspace

EVEN_S = 0.012  # least duration of a velocity change [s]
STOPPING = (0.25, 0.5, 0.75, 1.0)  # fractions of the braking time at which the path to the stop is checked
SLACK_M = 1e-3  # the path to a stop may lead out of the workspace by this much: at curved bounds it is straight [m]
INWARD_PER_S = 40.0  # gain on the distance between a bound and a tool that slides along it [1/s]
HALVINGS = 5  # bisections of the fraction of the desired velocity that can be kept
SWEEPS = 3  # passes over the bounds: a correction at one may add speed across another (they meet at 68 deg or more)
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


class SpeedChange:
    """Changes the joint velocities; no joint leaves its range `lower` to `upper`, shape (7,) [rad]."""

    def __init__(self, shape: ShapeLimits, lower: np.ndarray, upper: np.ndarray) -> None:
        self._lower = lower
        self._upper = upper
        self._ruckig = Ruckig(7)
        self._trajectory = Trajectory(7)
        self._input = InputParameter(7)
        self._input.control_interface = ControlInterface.Velocity
        self._input.max_acceleration = shape.acceleration.tolist()
        self._input.max_jerk = shape.jerk.tolist()
        self._input.target_acceleration = [0.0] * 7
        self._input.minimum_duration = EVEN_S

    def step(self, now: JointState, desired: np.ndarray, dt: float) -> JointState:
        """Returns the state dt [s] later, on the way to the velocities `desired`, shape (7,) [rad/s]."""
        self._plan(now, desired)
        q, v, a = self._trajectory.at_time(dt)
        within = read_only(np.clip(q, self._lower, self._upper))
        free = within == q
        return JointState(within, np.where(free, v, 0.0), np.where(free, a, 0.0), self._trajectory.duration)

    def stopping(self, now: JointState) -> Iterable[np.ndarray]:
        """Yields joints, shape (7,) [rad], on the path to the earliest stop; the last are at rest."""
        self._plan(now, np.zeros(7))
        for fraction in STOPPING:
            yield np.clip(self._trajectory.at_time(fraction * self._trajectory.duration)[0], self._lower, self._upper)

    def _plan(self, now: JointState, desired: np.ndarray) -> None:
        state = self._input
        state.current_position, state.current_velocity = now.q.tolist(), now.v.tolist()
        state.current_acceleration, state.target_velocity = now.a.tolist(), desired.tolist()
        result = self._ruckig.calculate(state, self._trajectory)
        if result not in (Result.Working, Result.Finished):
            raise ArithmeticError(f"no motion from velocity {now.v} and acceleration {now.a} to {desired}: {result}")


class WorkspaceBrake:
    """Limits each step so that the tool can still stop inside.

    The target stops abruptly at the end of the workspace, but the goal that follows it needs a distance to stop. So the
    brake takes a step only if the joints could then still come to rest with the tool inside. Otherwise it reduces the
    desired velocity as little as possible. First it removes the part that carries the tool out, by a motion that
    changes neither the other directions nor the orientation of the tool, so that the tool slides along the bound. If
    that is not enough, it scales the rest down too. A step that stays inside is not changed.

    Args:
        workspace: of the tool point.
        tool_position: of the tool point, shape (3,) [m], at joints q, shape (7,) [rad].
        tool_jacobian: geometric Jacobian of the tool point, shape (6, 7), at joints q.
        acceleration: deceleration of each joint when it brakes, shape (7,) [rad/s^2].
    """

    def __init__(
        self,
        workspace: Workspace,
        tool_position: Callable[[np.ndarray], np.ndarray],
        tool_jacobian: Callable[[np.ndarray], np.ndarray],
        acceleration: np.ndarray,
    ) -> None:
        self._workspace = workspace
        self._tool_position = tool_position
        self._tool_jacobian = tool_jacobian
        self._acceleration = acceleration

    def step(self, change: SpeedChange, now: JointState, desired: np.ndarray, dt: float) -> tuple[JointState, bool]:
        """Returns the state after dt [s], and whether the brake reduced the desired velocities, (7,) [rad/s]."""
        free = change.step(now, desired, dt)
        out = self._out(change, free)
        if out <= SLACK_M:
            return free, False
        rest = np.zeros(7)
        stopping = change.step(now, rest, dt)
        # A tool that can no longer stop inside may take any step that leads it out no further than a full stop does.
        bound = max(SLACK_M, self._out(change, stopping))
        if out <= bound:
            return free, False
        along = self.along(now.q, desired)
        best = change.step(now, along, dt)
        if self._out(change, best) <= bound:
            kept, given_up = along, desired
        else:
            kept, given_up, best = rest, along, stopping
        for _ in range(HALVINGS):
            middle = 0.5 * (kept + given_up)
            tried = change.step(now, middle, dt)
            if self._out(change, tried) <= bound:
                kept, best = middle, tried
            else:
                given_up = middle
        return best, True

    def along(self, q: np.ndarray, desired: np.ndarray) -> np.ndarray:
        """Returns the joint velocities without what carries the tool beyond a bound; shape (7,) [rad/s], at q [rad]."""
        position, J = self._tool_position(q), self._tool_jacobian(q)
        normals = self._workspace.outward(position)
        # In units of each joint's deceleration, so that the strong joints move most.
        strong = J * self._acceleration
        outward_motions = np.concatenate([normals.T, np.zeros((3, len(normals)))])
        corrections = strong.T @ np.linalg.solve(strong @ strong.T + DAMPING**2 * np.eye(6), outward_motions)
        corrections *= self._acceleration[:, None] / np.maximum(
            np.sum(normals.T * (strong[:3] @ corrections), axis=0), LEAST
        )
        left = desired
        for _ in range(SWEEPS):
            for normal, column, room in zip(normals, corrections.T, self._workspace.rooms(position)):
                excess = float(normal @ J[:3] @ left) - INWARD_PER_S * room
                left = left - max(excess, 0.0) * column
        # Near a singular pose this may need fast joints; none may be faster than in the desired velocity.
        pace, allowed = (float(np.max(np.abs(v) / self._acceleration)) for v in (left, desired))
        return left if pace <= allowed else allowed / pace * left

    def _out(self, change: SpeedChange, now: JointState) -> float:
        """Returns the greatest distance of the tool outside the workspace if the joints stop from now on [m]."""
        return -min(min(self._workspace.rooms(self._tool_position(q))) for q in change.stopping(now))
