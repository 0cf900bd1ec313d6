"""Kinematics of a calibrated arm: the closed form of the nominal arm, refined by Newton steps on the real one.

A calibrated arm has no exact spherical shoulder and wrist, so no closed form. That of the nominal arm is asked for the
pose that it must reach for the calibrated one to arrive near its target; the difference of the two is taken at the
present joints, so a tool at rest leaves the joints at rest. Newton steps of least length remove the remaining error.
They have no component along the self-motion: the elbow stays where the closed form put it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, hypot, sin, sqrt
from typing import Sequence

import numpy as np

from iiwa_kinematics.chain import Ball, Vector, fastest_beyond
from iiwa_kinematics.elbow_choice import CROSSING_RAD
from iiwa_kinematics.elbow_circle import Branch
from iiwa_kinematics.inverse import IkFailure, IkResult, Kinematics, inverse_pose
from iiwa_kinematics.robot_model import RobotModel, read_only


@dataclass(frozen=True, eq=False)
class DhParameters:
    """Denavit-Hartenberg parameters of joints 1 to 7, or their deviations from those of the data sheet.

    Joint i turns about the z axis of frame i - 1; from there to frame i:  Rz(q + theta) Tz(d) Tx(a) Rx(alpha)  (the
    standard, distal convention). Frame 0 is the base, frame 7 the flange. Neighbouring axes of these arms cross at
    right angles, so small errors of the arm are small changes of these parameters.

    Source: the table of the KUKA Sunrise Toolbox, whose zero position and directions of rotation are those of the arm.
    """

    a: np.ndarray  # along x, shape (7,) [m]
    alpha: np.ndarray  # about x, shape (7,) [rad]
    d: np.ndarray  # along the joint's axis z, shape (7,) [m]
    theta: np.ndarray  # about z, at joint zero, shape (7,) [rad]

    @property
    def any(self) -> bool:
        """Whether a parameter is not zero."""
        return any(np.any(values) for values in (self.a, self.alpha, self.d, self.theta))

    def plus(self, deviations: DhParameters) -> DhParameters:
        pairs = ((getattr(self, name), getattr(deviations, name)) for name in ("a", "alpha", "d", "theta"))
        return DhParameters(*(read_only(nominal + deviation) for nominal, deviation in pairs))

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Returns the poses of frames 0 to 7 in the base, shape (8, 4, 4) [m], at joints q, shape (7,) [rad]."""
        angle = np.asarray(q, dtype=float) + self.theta
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(self.alpha), np.sin(self.alpha)
        zero, one = np.zeros(7), np.ones(7)
        links = np.array([
            [c, -s * ca, s * sa, self.a * c],
            [s, c * ca, -c * sa, self.a * s],
            [zero, sa, ca, self.d],
            [zero, zero, zero, one],
        ]).transpose(2, 0, 1)  # fmt: skip
        frames = np.empty((8, 4, 4))
        frames[0] = np.eye(4)
        for i, link in enumerate(links):
            frames[i + 1] = frames[i] @ link
        return frames

    @cached_property
    def rows(self) -> list[tuple[float, float, float, float, float]]:
        """For joints 7 to 1: theta [rad], cosine and sine of alpha, a and d [m]."""
        columns = self.theta, np.cos(self.alpha), np.sin(self.alpha), self.a, self.d
        return list(zip(*(column[::-1].tolist() for column in columns)))


def nominal_parameters(model: RobotModel) -> DhParameters:
    """Returns the parameters of an arm as in its data sheet, with its media flange."""
    return DhParameters(
        a=read_only(np.zeros(7)),
        alpha=read_only(np.radians([-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0])),
        d=read_only([model.base_shoulder, 0.0, model.shoulder_elbow, 0.0, model.elbow_wrist, 0.0, model.wrist_flange]),
        theta=read_only(np.zeros(7)),
    )


DAMPING = 1e-3  # fraction of the error whose square damps a step; keeps steps short where the arm is outstretched


def kinematics_of(
    model: RobotModel, T_flange_tool: np.ndarray, deviations: DhParameters | None, elbow_preference: float = 0.0
) -> Kinematics:
    """Returns the kinematics of an arm with its tool; arguments as in `Kinematics`. `deviations` are calibrated less
    nominal parameters; None or all zero: the closed form alone."""
    if deviations is None or not deviations.any:
        return Kinematics(model, T_flange_tool, elbow_preference)
    return CalibratedKinematics(model, nominal_parameters(model).plus(deviations), T_flange_tool, elbow_preference)


class CalibratedKinematics(Kinematics):
    """An arm with calibrated parameters, and its tool; the joint ranges are those of the data sheet."""

    calibrated = True

    def __init__(
        self,
        model: RobotModel,
        parameters: DhParameters,
        T_flange_tool: np.ndarray | None = None,
        elbow_preference: float = 0.0,
    ) -> None:
        super().__init__(model, T_flange_tool, elbow_preference)
        self._parameters = parameters
        nominal, norm = nominal_parameters(model), np.linalg.norm
        self.slack = (
            float(norm(np.concatenate((parameters.a - nominal.a, parameters.d - nominal.d)))),
            float(norm(np.concatenate((parameters.alpha - nominal.alpha, parameters.theta - nominal.theta)))),
        )
        fore = model.elbow_wrist + self.slack[0] + 1.5 * self.slack[1]
        self._inner = [*[model.shoulder_elbow + fore] * 2, *[fore] * 2, *[self.slack[0]] * 3]

    def forward(self, q: np.ndarray) -> np.ndarray:
        return self._parameters.frames(q)[-1] @ self.T_flange_tool

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        return self._pose_and_jacobian(q)[1]

    def tool_point(self, q: Sequence[float], around: float = 0.0) -> tuple[Vector, list[float]]:
        x, y, z = self._tool
        distances = []
        for angle, (theta, ca, sa, a, d) in zip(reversed(q), self._parameters.rows):
            x, y, z = x + a, ca * y - sa * z, sa * y + ca * z + d
            distances.append(hypot(x, y))
            c, s = cos(angle + theta), sin(angle + theta)
            x, y = c * x - s * y, s * x + c * y
        reaches = [max(distance + around, inner) for distance, inner in zip(reversed(distances), self._inner)]
        return (x, y, z), reaches

    def fastest_point(self, balls: Sequence[Ball], q: Sequence[float], v: Sequence[float]) -> float:
        x = y = z = wx = wy = wz = fastest = 0.0
        for joint, (angle, rate, (theta, ca, sa, a, d)) in enumerate(zip(q, v, reversed(self._parameters.rows)), 1):
            wz += rate
            c, s = cos(angle + theta), sin(angle + theta)
            wx, wy, x, y = c * wx + s * wy, c * wy - s * wx, c * x + s * y, c * y - s * x
            x, y, z = x + wy * d, y + wz * a - wx * d, z - wy * a
            wy, wz, y, z = ca * wy + sa * wz, ca * wz - sa * wy, ca * y + sa * z, ca * z - sa * y
            if joint in (3, 5):  # elbow and wrist
                fastest = max(fastest, sqrt(x * x + y * y + z * z))
        return max(fastest, fastest_beyond(balls, (x, y, z), (wx, wy, wz)))

    def inverse(self, T_base_tool: np.ndarray, q_seed: np.ndarray, keep_branch: bool = False) -> IkResult:
        T, seed = self._checked(T_base_tool, q_seed)
        result = self._attempt(T, seed, seed, keep_branch)
        if result.q is None:  # the deviation of the arm at the target may differ from the one at the seed
            nominal = super().inverse(T, seed, keep_branch)
            if nominal.q is not None:
                return self._attempt(T, seed, nominal.q, keep_branch)
        return result

    def _attempt(self, T: np.ndarray, seed: np.ndarray, q_deviation: np.ndarray, keep_branch: bool) -> IkResult:
        """Returns joints for the pose T, with the deviation of the arm taken at the joints `q_deviation`."""
        deviation = inverse_pose(self.forward(q_deviation)) @ super().forward(q_deviation)
        nominal = super().inverse(T @ deviation, seed, keep_branch)
        if nominal.q is None:
            return nominal
        q = self.refined(nominal.q, T)
        if q is None:
            return IkResult(None, IkFailure.NOT_REFINED)
        if keep_branch and not _same_fold(q, nominal.q):
            return IkResult(None, IkFailure.OTHER_BRANCH)
        return replace(nominal, q=q, branch=Branch.of(q))

    def refined(self, q: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray | None:
        # four steps are enough almost everywhere; where they are not, the arm is at the end of its reach
        max_steps = 20
        reached = 1e-10  # a pose is reached when the errors of position [m] and rotation [rad] are at most this
        lower, upper = self.model.lower, self.model.upper
        q = np.clip(q, lower, upper)
        for _ in range(max_steps):
            T, J = self._pose_and_jacobian(q)
            if np.sum(T[:3, :3] * T_base_tool[:3, :3]) < 1.0:  # more than 90 deg off
                return None
            error = _pose_error(T, T_base_tool)
            if np.abs(error).max() <= reached:
                return read_only(q)
            q = newton_step(q, J, error, lower, upper)
        return None

    def _pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pose of the tool, shape (4, 4) [m], and its geometric Jacobian in the base, shape (6, 7)."""
        frames = self._parameters.frames(q)
        T = frames[-1] @ self.T_flange_tool
        axes = frames[:7, :3, 2]
        return T, np.concatenate((np.cross(axes, T[:3, 3] - frames[:7, :3, 3]), axes), axis=1).T


def _pose_error(T: np.ndarray, T_target: np.ndarray) -> np.ndarray:
    """Returns position error [m] and rotation error, shape (6,), in the base. The rotation error is the axis times
    the sine of the angle, which is the angle near the target. A rounding error of the target's orthonormality has no
    effect on it."""
    rotation = 0.5 * np.cross(T[:3, :3], T_target[:3, :3], axis=0).sum(axis=1)
    return np.concatenate((T_target[:3, 3] - T[:3, 3], rotation))


def newton_step(q: np.ndarray, J: np.ndarray, error: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns the joints after a damped Newton step; a joint that would leave its range stays at its end. `error`,
    shape (n,), is what the step removes, and J, shape (n, 7), its derivative."""
    free = np.ones(7, dtype=bool)
    damping = (DAMPING * np.linalg.norm(error)) ** 2 * np.eye(len(error))
    while True:
        F = J[:, free]
        step = np.zeros(7)
        step[free] = F.T @ np.linalg.lstsq(F @ F.T + damping, error, rcond=None)[0]
        beyond = free & ((q + step < lower) | (q + step > upper))
        if not beyond.any():
            return q + step
        q = np.where(beyond, np.clip(q + step, lower, upper), q)
        free &= ~beyond


def _same_fold(q: np.ndarray, q_nominal: np.ndarray) -> bool:
    """Returns whether joint 4 bends to the same side, and joints 2 and 6 too except near zero."""
    turned = [i for i in (1, 3, 5) if np.copysign(1.0, q[i]) != np.copysign(1.0, q_nominal[i])]
    return 3 not in turned and bool(np.all(np.abs(q[turned]) < CROSSING_RAD))
