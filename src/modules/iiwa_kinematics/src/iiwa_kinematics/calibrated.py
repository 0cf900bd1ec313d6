"""Kinematics of a calibrated arm: the closed form of the nominal arm, refined by Newton steps on the real one.

A calibrated arm has no exact spherical shoulder and wrist, so it has no closed form. It differs from the nominal arm by
a few millimetres only. The closed form therefore chooses the solution: it is asked for the pose that the nominal arm
must reach for the calibrated one to arrive near its target. The difference between the two arms is taken at the present
joints, so a tool at rest leaves the joints at rest. Newton steps of least length on the calibrated arm remove the
remaining error. They have no component along the self-motion: the elbow stays where the closed form put it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from iiwa_kinematics.dh import DhParameters, nominal_parameters
from iiwa_kinematics.elbow_choice import CROSSING_RAD
from iiwa_kinematics.elbow_circle import Branch
from iiwa_kinematics.inverse import IkFailure, IkResult, Kinematics
from iiwa_kinematics.poses import inverse_pose, read_only
from iiwa_kinematics.robot_model import RobotModel

MAX_STEPS = 20
"""Four steps are enough almost everywhere; where they are not, the arm is at the end of its reach."""

REACHED = 1e-10
"""A pose is reached when the errors of position [m] and rotation [rad] are at most this."""

DAMPING = 1e-3
"""Fraction of the error whose square damps a step; keeps steps short where the arm is outstretched."""


def kinematics_of(
    model: RobotModel, T_flange_tool: np.ndarray, deviations: DhParameters | None, elbow_preference: float = 0.0
) -> Kinematics:
    """Returns the kinematics of an arm with its tool.

    Args:
        model: the arm as in its data sheet.
        T_flange_tool: pose of the tool in the flange, shape (4, 4) [m].
        deviations: calibrated less nominal parameters; None or all zero: the closed form alone.
        elbow_preference: arm angle to which the elbow slowly returns [rad]; 0 is up.
    """
    if deviations is None or not deviations.any:
        return Kinematics(model, T_flange_tool, elbow_preference)
    return CalibratedKinematics(model, nominal_parameters(model).plus(deviations), T_flange_tool, elbow_preference)


class CalibratedKinematics(Kinematics):
    """An arm with calibrated parameters, and its tool.

    Args:
        model: the arm as in its data sheet; its joint ranges hold here too.
        parameters: its calibrated parameters.
        T_flange_tool: pose of the tool in the flange, shape (4, 4) [m]; the flange itself if omitted.
        elbow_preference: arm angle to which the elbow slowly returns [rad]; 0 is up.
    """

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

    def forward(self, q: np.ndarray) -> np.ndarray:
        return self._parameters.frames(q)[-1] @ self.T_flange_tool

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        return self._pose_and_jacobian(q)[1]

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
        lower, upper = self.model.lower, self.model.upper
        q = np.clip(q, lower, upper)
        for _ in range(MAX_STEPS):
            T, J = self._pose_and_jacobian(q)
            if np.sum(T[:3, :3] * T_base_tool[:3, :3]) < 1.0:  # more than 90 deg off
                return None
            error = _pose_error(T, T_base_tool)
            if np.abs(error).max() <= REACHED:
                return read_only(q)
            q = _stepped(q, J, error, lower, upper)
        return None

    def _pose_and_jacobian(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the pose of the tool, shape (4, 4) [m], and its geometric Jacobian in the base, shape (6, 7)."""
        frames = self._parameters.frames(q)
        T = frames[-1] @ self.T_flange_tool
        axes = frames[:7, :3, 2]
        return T, np.concatenate((np.cross(axes, T[:3, 3] - frames[:7, :3, 3]), axes), axis=1).T


def _pose_error(T: np.ndarray, T_target: np.ndarray) -> np.ndarray:
    """Returns position error [m] and rotation error, shape (6,), in the base.

    The rotation error is the axis times the sine of the angle, which is the angle near the target. A rounding error of
    the target's orthonormality has no effect on it.
    """
    rotation = 0.5 * np.cross(T[:3, :3], T_target[:3, :3], axis=0).sum(axis=1)
    return np.concatenate((T_target[:3, 3] - T[:3, 3], rotation))


def _stepped(q: np.ndarray, J: np.ndarray, error: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns the joints after a damped Newton step; a joint that would leave its range stays at its end."""
    free = np.ones(7, dtype=bool)
    damping = (DAMPING * np.linalg.norm(error)) ** 2 * np.eye(6)
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
