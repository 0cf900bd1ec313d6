"""Motions planned in advance: joint moves, and lines and circles of the tool turned into joint motions.

A motion is smooth in speed and synchronises all joints; it is a function of its own time, which the arm may slow down,
stop and resume.
"""

from __future__ import annotations

from typing import Union

import numpy as np
import pinocchio as pin

from common.poses import pose, read_only
from rig_simulation.devices.sunrise.robot import Robot


class SmoothStep:
    """The path parameter s from 0 to 1: its speed rises as sin^2 over a ramp, stays, and falls likewise; `speed` [1/s]
    and `acceleration` [1/s^2] are the highest ones.
    """

    def __init__(self, speed: float, acceleration: float) -> None:
        self._speed = min(speed, (2.0 * acceleration / np.pi) ** 0.5)
        self._ramp = np.pi * self._speed / (2.0 * acceleration)
        self.duration = 1.0 / self._speed + self._ramp
        self.braking_time = self._speed / acceleration

    def at(self, t: float) -> float:
        """Returns s at time t [s]."""
        if t <= 0.0:
            return 0.0
        if t >= self.duration:
            return 1.0
        if t > 0.5 * self.duration:
            return 1.0 - self.at(self.duration - t)
        if t >= self._ramp:
            return self._speed * (t - 0.5 * self._ramp)
        return self._speed * (0.5 * t - self._ramp / (2.0 * np.pi) * np.sin(np.pi * t / self._ramp))


class JointMove:
    """A line in joint space between two different sets of joint angles, shape (7,) [rad], within the limits `speed` and
    `acceleration` of each joint, shape (7,) [rad/s], [rad/s^2].
    """

    def __init__(self, start: np.ndarray, end: np.ndarray, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self._start, self._end = read_only(start), read_only(end)
        self._shift = self._end - self._start
        distance = np.abs(self._shift)
        moved = distance > 0.0
        self._step = SmoothStep(
            float(np.min(speed[moved] / distance[moved])), float(np.min(acceleration[moved] / distance[moved]))
        )
        self.duration, self.braking_time = self._step.duration, self._step.braking_time

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]."""
        return self._end if t >= self.duration else self._start + self._step.at(t) * self._shift


class PathMove:
    """A path through `nodes`, joint angles at equal steps of s, shape (n, 7) [rad], n >= 2, slowed down until every
    joint keeps its limits `speed` and `acceleration`, shape (7,) [rad/s], [rad/s^2].
    `step`: desired course of s from 0 to 1.
    """

    SAMPLES = 500

    def __init__(self, nodes: np.ndarray, step: SmoothStep, speed: np.ndarray, acceleration: np.ndarray) -> None:
        self._nodes = read_only(nodes)
        self._slopes = read_only(np.gradient(self._nodes, axis=0))
        self._step = step
        dt = step.duration / self.SAMPLES
        q = np.array([self._at_parameter(step.at(k * dt)) for k in range(self.SAMPLES + 1)])
        v = np.diff(q, axis=0) / dt
        a = np.diff(v, axis=0) / dt
        self._slower = max(1.0, np.max(np.abs(v) / speed), np.max(np.abs(a) / acceleration) ** 0.5)
        self.duration, self.braking_time = step.duration * self._slower, step.braking_time * self._slower

    def at(self, t: float) -> np.ndarray:
        """Returns the joint angles, shape (7,) [rad], at time t [s]."""
        return self._at_parameter(self._step.at(t / self._slower))

    def _at_parameter(self, s: float) -> np.ndarray:
        last = len(self._nodes) - 1
        k = min(int(s * last), last - 1)
        u = s * last - k
        w = u * u * (3.0 - 2.0 * u)
        left, right = self._nodes[k], self._nodes[k + 1]
        bend = u * (1.0 - u) * ((1.0 - u) * self._slopes[k] - u * self._slopes[k + 1])
        return left + w * (right - left) + bend


ACCELERATION_M_S2 = 2.0
TURN_SPEED_RAD_S = 1.0
TURN_ACCELERATION_RAD_S2 = 4.0
NODE_DISTANCE_M = 0.005
NODE_TURN_RAD = 0.02
MIN_NODES = 20
MAX_NODES = 400
MAX_NODE_JUMP_RAD = 0.3
NEGLIGIBLE = 1e-9


PlannedMotion = Union[JointMove, PathMove]
"""`at(t)` returns the joint angles at its own time t up to its `duration` [s], beyond it those of the end.
`braking_time`: from its greatest speed to rest, at its greatest acceleration [s].
"""


class Unreachable(ValueError):
    """An impossible motion: no speed, no joint angles, or points that define no circle."""


class Line:
    """A line from one pose to another, shape (4, 4); the orientation turns evenly about one axis."""

    def __init__(self, start: np.ndarray, end: np.ndarray) -> None:
        self._start = start
        self._shift = end[:3, 3] - start[:3, 3]
        self._turn = pin.log3(start[:3, :3].T @ end[:3, :3])
        self.length = float(np.linalg.norm(self._shift))
        self.angle = float(np.linalg.norm(self._turn))

    def at(self, s: float) -> np.ndarray:
        """Returns the pose, shape (4, 4), at s in [0, 1]."""
        return pose(self._start[:3, :3] @ pin.exp3(s * self._turn), self._start[:3, 3] + s * self._shift)


class Circle:
    """An arc from a pose through the position of a second to a third; the orientation turns evenly.

    Raises Unreachable if the three positions are collinear.
    """

    def __init__(self, start: np.ndarray, via: np.ndarray, end: np.ndarray) -> None:
        p, u, w = start[:3, 3], via[:3, 3] - start[:3, 3], end[:3, 3] - start[:3, 3]
        normal = np.cross(u, w)
        area = float(normal @ normal)
        if not area > NEGLIGIBLE**2:
            raise Unreachable("three collinear points define no circle")
        self._centre = p + np.cross((u @ u) * w - (w @ w) * u, normal) / (2.0 * area)
        self._axis = normal / np.sqrt(area)
        self._arm = p - self._centre
        reach = end[:3, 3] - self._centre
        self._sweep = np.arctan2(self._axis @ np.cross(self._arm, reach), self._arm @ reach) % (2.0 * np.pi)
        self._orientation = Line(start, end)
        self.length = float(self._sweep * np.linalg.norm(self._arm))
        self.angle = self._orientation.angle

    def at(self, s: float) -> np.ndarray:
        """Returns the pose, shape (4, 4), at s in [0, 1]."""
        T = self._orientation.at(s)
        T[:3, 3] = self._centre + pin.exp3(s * self._sweep * self._axis) @ self._arm
        return T


def plan(
    path: Line | Circle,  # starts at the present pose of the tool
    speed: float,  # of the tool point [m/s]
    robot: Robot,
    T_flange_tool: np.ndarray,  # the tool, shape (4, 4)
    q: np.ndarray,  # present joint angles, shape (7,) [rad]
    joint_acceleration: np.ndarray,  # limits, shape (7,) [rad/s^2]
) -> PathMove | None:
    """Returns the joint motion that moves the tool along the path, or None for a path without length; raises
    Unreachable if the speed is not positive, or a pose of the path has no joint angles near the last ones.
    """
    if not 0.0 < speed < np.inf:
        raise Unreachable(f"the speed is {speed} m/s, but must be positive")
    if not np.isfinite(path.length + path.angle):
        raise Unreachable("the pose is not finite")
    if path.length < NEGLIGIBLE and path.angle < NEGLIGIBLE:
        return None
    distance, turn = max(path.length, NEGLIGIBLE), max(path.angle, NEGLIGIBLE)
    step = SmoothStep(
        min(speed / distance, TURN_SPEED_RAD_S / turn),
        min(ACCELERATION_M_S2 / distance, TURN_ACCELERATION_RAD_S2 / turn),
    )
    count = int(np.clip(max(distance / NODE_DISTANCE_M, turn / NODE_TURN_RAD), MIN_NODES, MAX_NODES))
    nodes = [q]
    for k in range(1, count + 1):
        solution = robot.solve(path.at(k / count), T_flange_tool, nodes[-1])
        if solution is None or np.max(np.abs(solution - nodes[-1])) > MAX_NODE_JUMP_RAD:
            raise Unreachable("the path leaves the range of the joints or the reach of the arm")
        nodes.append(solution)
    return PathMove(np.array(nodes), step, robot.max_speed, joint_acceleration)


def shifted(T_base_tool: np.ndarray, shift: np.ndarray, along_tool: bool) -> np.ndarray:
    """Returns the pose, shape (4, 4), moved by `shift`, shape (3,) [m], along the tool's axes or the base's."""
    T = T_base_tool.copy()
    T[:3, 3] += T[:3, :3] @ shift if along_tool else shift
    return T
