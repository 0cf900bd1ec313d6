"""A straight line of the tool, planned and checked as a whole before it starts; the tool turns about one axis. A cubic
curve connects the closed form's joints of evenly spaced poses. One pace holds for the whole line, so that nowhere on it
a joint, or a point of the arm, passes a limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ruckig import InputParameter, Ruckig, Trajectory

from common.errors import RigError
from common.poses import pose, read_only
from common.rotations import rotation_angle, scaled_rotation
from iiwa_kinematics import Kinematics
from kuka_control.limits.moving_arm import MovingPoints, ShapeLimits
from kuka_control.model.workspace import Infeasible, Workspace

STEP_M = 0.004  # distance between two poses with joints of their own [m]
LEVER_M = 0.2  # a turn of the tool counts as a way of so much for each rad [m]
LEAST_STEPS = 8
PART_STEPS = 3  # so many steps are one part for the collision guard
SHORTEST_M = 1e-4  # no line may be shorter [m]
JUMP_RAD = 0.1  # joints that turn by more than this from pose to pose would fold the arm differently
OFF_M = 5e-4  # the curve through the joints may be this far from the line [m]
SLOWEST_M_PER_S = 0.01  # a line on which joints at full speed move the tool more slowly than this is refused
PLANNED = 0.4  # fraction of the limits of acceleration and jerk that the plan uses; the rest brakes and catches up


class MoveRefused(RigError):
    """A motion for a program is refused; the message is one sentence."""


@dataclass(frozen=True)
class LineLimits:
    kinematics: Kinematics  # of the arm with its tool
    workspace: Workspace  # of the tool point
    lower: np.ndarray  # joint ranges, shape (7,) [rad]
    upper: np.ndarray
    joint_speeds: np.ndarray  # shape (7,) [rad/s]
    shape: ShapeLimits  # of the joints
    speed: float  # of every point of the moving arm [m/s]
    points: MovingPoints


class LinePlan:
    """Joints along a line, at times from its start; `length` of the way, with `LEVER_M` for each rad of turn [m],
    `duration` from rest to rest [s], and `q_goal`, joints at the end, shape (7,) [rad]."""

    def __init__(self, q: np.ndarray, length: float, pace: Trajectory) -> None:
        self.length = length
        self.duration = pace.duration
        self.q_start = read_only(q[0])
        self.q_goal = read_only(q[-1])
        self._q = q
        self._slopes = _slopes(q)
        self._pace = pace

    @property
    def path(self) -> list[np.ndarray]:
        """The joints at the ends of short parts of the line, shape (7,) each [rad]."""
        return [*self._q[:-1:PART_STEPS], self._q[-1]]

    def at(self, time: float) -> tuple[np.ndarray, np.ndarray, float]:
        """Returns joints [rad] and their speeds [rad/s], shape (7,) each, and the fraction of the way, 0 to 1."""
        if time >= self.duration:
            return self.q_goal, np.zeros(7), 1.0
        s, v, _ = self._pace.at_time(max(time, 0.0))
        q, slope = _curve(self._q, self._slopes, s[0])
        return q, v[0] * slope, s[0]


def plan_line(limits: LineLimits, q_start: np.ndarray, T_goal: np.ndarray, velocity: float) -> LinePlan:
    """Returns the plan of a line from the joints `q_start`, shape (7,) [rad], to a tool pose, shape (4, 4) [m].
    `velocity` is that of the tool [m/s]. Raises MoveRefused where the line cannot be followed."""
    T_start = limits.kinematics.forward(q_start)
    R = T_start[:3, :3].T @ T_goal[:3, :3]
    length = float(np.linalg.norm(T_goal[:3, 3] - T_start[:3, 3]))
    way = max(length, LEVER_M * rotation_angle(R))
    if way < SHORTEST_M:
        raise MoveRefused(f"The line is {1e3 * way:.2f} mm long; the tool is there already, and nothing moves.")
    steps = max(LEAST_STEPS, int(np.ceil(way / STEP_M)))

    def T(s: float) -> np.ndarray:
        return pose(T_start[:3, :3] @ scaled_rotation(R, s), (1.0 - s) * T_start[:3, 3] + s * T_goal[:3, 3])

    q = [np.asarray(q_start, dtype=float)]
    for i in range(1, steps + 1):
        q.append(_next(limits, T(i / steps), q[-1], f"{100 * i / steps:.0f} % of the line"))
    joints = np.array(q)
    slopes = _slopes(joints)
    for i in range(steps):
        s = (i + 0.5) / steps
        off = np.linalg.norm(limits.kinematics.forward(_curve(joints, slopes, s)[0])[:3, 3] - T(s)[:3, 3])
        if off > OFF_M:
            raise MoveRefused(f"At {100 * s:.0f} % of the line the joints turn too abruptly to keep to it.")
    return LinePlan(joints, way, _pace(limits, joints, way, velocity))


def _next(limits: LineLimits, T: np.ndarray, q_before: np.ndarray, where: str) -> np.ndarray:
    position = limits.workspace.constrain(T[:3, 3])
    place = f"At {where}, ({', '.join(f'{x:.3f}' for x in T[:3, 3])}) m,"
    if isinstance(position, Infeasible):
        raise MoveRefused(f"{place} the line cannot be followed: {position.reason.value}.")
    if position.bounds:
        raise MoveRefused(f"{place} the line is outside the workspace: {' and '.join(map(str, position.bounds))}.")
    q = limits.kinematics.inverse(T, q_before, keep_branch=True)
    if q.q is None:
        raise MoveRefused(f"{place} the line cannot be followed. {q.failure}")
    beyond = np.flatnonzero((q.q < limits.lower) | (q.q > limits.upper))
    if len(beyond):
        raise MoveRefused(f"{place} joint {beyond[0] + 1} would be at the end of its range.")
    joint = int(np.argmax(np.abs(q.q - q_before)))
    if abs(q.q[joint] - q_before[joint]) > JUMP_RAD:
        raise MoveRefused(f"{place} joint {joint + 1} would have to turn at once by more than a line allows.")
    return q.q


def _pace(limits: LineLimits, q: np.ndarray, way: float, velocity: float) -> Trajectory:
    """Returns the fraction of the way over time, from rest to rest."""
    steps = len(q) - 1
    first = np.abs(np.diff(q, axis=0)).max(axis=0) * steps  # greatest derivatives by the fraction of the way
    second = np.abs(np.diff(q, 2, axis=0)).max(axis=0) * steps**2
    third = np.abs(np.diff(q, 3, axis=0)).max(axis=0) * steps**3
    acceleration, jerk = PLANNED * limits.shape.acceleration, PLANNED * limits.shape.jerk
    tiny = 1e-12
    joints = min(
        float(np.min(limits.joint_speeds / np.maximum(first, tiny))),
        float(np.min(np.sqrt(0.5 * acceleration / np.maximum(second, tiny)))),
        float(np.min(np.cbrt(0.3 * jerk / np.maximum(third, tiny)))),
    )
    if joints * way < min(SLOWEST_M_PER_S, velocity):
        joint = int(np.argmax(first / limits.joint_speeds))
        raise MoveRefused(
            f"The line passes so near to a singular pose that joint {joint + 1} allows the tool only "
            f"{1e3 * joints * way:.1f} mm/s."
        )
    points = max(map(limits.points.speed, q.tolist(), _slopes(q).tolist()))  # by the fraction of the way
    fastest = min(joints, velocity / way, limits.speed / max(points, way))
    plan, trajectory = InputParameter(1), Trajectory(1)
    plan.target_position, plan.max_velocity = [1.0], [fastest]
    plan.max_acceleration = [float(np.min(0.5 * acceleration / np.maximum(first, tiny)))]
    # The term 3 q'' s' s'' is bounded by the two others' budget; a slow start keeps it small.
    plan.max_jerk = [float(np.min(0.3 * jerk / np.maximum(first, tiny)))]
    Ruckig(1).calculate(plan, trajectory)
    return trajectory


def _slopes(q: np.ndarray) -> np.ndarray:
    """Returns the derivatives of the curve at its joints, shape (n, 7), by the fraction of the way."""
    return np.gradient(q, axis=0, edge_order=2) * (len(q) - 1)


def _curve(q: np.ndarray, slopes: np.ndarray, s: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns joints and their derivatives, shape (7,) each, at the fraction s of the way: cubic between two poses."""
    steps = len(q) - 1
    i = min(int(s * steps), steps - 1)
    x = s * steps - i
    a, b, m, n = q[i], q[i + 1], slopes[i] / steps, slopes[i + 1] / steps
    joints = a + x * (m + x * (3.0 * (b - a) - 2.0 * m - n + x * (2.0 * (a - b) + m + n)))
    slope = m + x * (6.0 * (b - a) - 4.0 * m - 2.0 * n + x * 3.0 * (2.0 * (a - b) + m + n))
    return joints, steps * slope
