"""Kinematics of an arm whose Denavit-Hartenberg parameters were calibrated: the closed form, then refined numerically.

A calibrated arm has no spherical shoulder and wrist, so no closed form. But it is the nominal arm to within a few
millimetres. The closed form chooses: it is asked for the pose that the nominal arm must go to, so that the calibrated
one comes about where it should; this difference is taken where the arm is now, so a tool that stands still leaves the
joints where they are. Then Newton steps on the calibrated arm, of the least length, remove the rest. A step of
the least length has no part along the self-motion: the elbow stays where the closed form put it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from common.poses import inverse as inverse_pose
from common.poses import read_only
from kuka_control.kinematics.dh import DhDeviations, DhTable, nominal_table
from kuka_control.kinematics.elbow_circle import Branch
from kuka_control.kinematics.inverse import CROSSING_RAD, IkFailure, IkResult, Kinematics
from kuka_control.robot_model import RobotModel

MAX_STEPS = 20
"""Where four steps do not do, the arm is at an end of its reach; more steps than these do not help there."""

REACHED = 1e-10
"""A pose is reached when position [m] and rotation [rad] are off by no more than this."""

DAMPING = 1e-3
"""Part of the error whose square damps a step, so that it stays short where the arm is outstretched."""


def kinematics_of(
    model: RobotModel, T_flange_tool: np.ndarray, dh: DhDeviations | None, elbow_preference: float = 0.0
) -> Kinematics:
    """Returns the kinematics of an arm with its tool, shape (4, 4) [m].

    Args:
        model: the arm as in its data sheet.
        T_flange_tool: pose of the tool in the flange, shape (4, 4) [m].
        dh: how a calibrated arm is off that; None or all zero: it is not, and the closed form alone counts.
        elbow_preference: arm angle that the elbow slowly goes to [rad]; 0 is up.
    """
    if dh is None or not dh.any:
        return Kinematics(model, T_flange_tool, elbow_preference)
    return CalibratedKinematics(model, nominal_table(model).plus(dh), T_flange_tool, elbow_preference)


class CalibratedKinematics(Kinematics):
    """An arm with calibrated parameters, and its tool.

    Args:
        model: the arm as in its data sheet; its joint ranges count here too.
        table: its calibrated parameters.
        T_flange_tool: pose of the tool in the flange, shape (4, 4) [m]; the flange itself where left out.
        elbow_preference: arm angle that the elbow slowly goes to [rad]; 0 is up.
    """

    calibrated = True

    def __init__(
        self,
        model: RobotModel,
        table: DhTable,
        T_flange_tool: np.ndarray | None = None,
        elbow_preference: float = 0.0,
    ) -> None:
        super().__init__(model, T_flange_tool, elbow_preference)
        self._chain, last_joint, flange = _chain(table)
        placement = flange * pin.SE3(self.T_flange_tool)
        self._tool = self._chain.addFrame(pin.Frame("tool", last_joint, 0, placement, pin.FrameType.OP_FRAME))

    def forward(self, q: np.ndarray) -> np.ndarray:
        return self._placement(self._chain.createData(), q).homogeneous

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        data = self._chain.createData()  # its own in each call: other threads ask too
        return pin.computeFrameJacobian(
            self._chain, data, np.asarray(q, dtype=float), self._tool, pin.LOCAL_WORLD_ALIGNED
        )

    def inverse(self, T_base_tool: np.ndarray, near: np.ndarray, keep_branch: bool = False) -> IkResult:
        T, present = self._checked(T_base_tool, near)
        result = self._attempt(T, present, present, keep_branch)
        if result.q is None:  # perhaps only because the arm deviates otherwise there than here
            there = super().inverse(T, present, keep_branch)
            if there.q is not None:
                return self._attempt(T, present, there.q, keep_branch)
        return result

    def _attempt(self, T: np.ndarray, present: np.ndarray, place: np.ndarray, keep_branch: bool) -> IkResult:
        """Returns joints for the pose T; the deviation of the arm is taken with its joints at `place`."""
        deviation = inverse_pose(self.forward(place)) @ super().forward(place)
        seed = super().inverse(T @ deviation, present, keep_branch)
        if seed.q is None:
            return seed
        q = self.refined(seed.q, T)
        if q is None:
            return IkResult(None, IkFailure.NOT_REFINED)
        if keep_branch and not _same_fold(q, seed.q):
            return IkResult(None, IkFailure.OTHER_BRANCH)
        return replace(seed, q=q, branch=Branch.of(q))

    def refined(self, q: np.ndarray, T_base_tool: np.ndarray) -> np.ndarray | None:
        data, target = self._chain.createData(), _rigid(T_base_tool)
        lower, upper = self.model.lower, self.model.upper
        q = np.clip(q, lower, upper)
        for _ in range(MAX_STEPS):
            error = pin.log6(self._placement(data, q).actInv(target)).vector
            if np.abs(error).max() <= REACHED:
                return read_only(q)
            J = pin.computeFrameJacobian(self._chain, data, q, self._tool, pin.LOCAL)
            q = _stepped(q, J, error, lower, upper)
        return None

    def _placement(self, data: pin.Data, q: np.ndarray) -> pin.SE3:
        pin.forwardKinematics(self._chain, data, np.asarray(q, dtype=float))
        return pin.updateFramePlacement(self._chain, data, self._tool)


def _chain(table: DhTable) -> tuple[pin.Model, int, pin.SE3]:
    """Returns the chain of joints, the number of the last one, and the flange's placement behind it."""
    chain, joint, behind = pin.Model(), 0, pin.SE3.Identity()
    for i, (a, alpha, d, theta) in enumerate(zip(table.a, table.alpha, table.d, table.theta)):
        turned = pin.SE3(pin.utils.rotate("z", theta), np.zeros(3))
        joint = chain.addJoint(joint, pin.JointModelRZ(), behind * turned, f"joint_{i + 1}")
        behind = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, d]))
    return chain, joint, behind


def _stepped(q: np.ndarray, J: np.ndarray, error: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Returns the joints after a damped Newton step; a joint that it would carry out of its range stays at its end."""
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


def _same_fold(q: np.ndarray, seed: np.ndarray) -> bool:
    """Returns whether joint 4 bends to the same side, and joints 2 and 6 too except near zero."""
    turned = [i for i in (1, 3, 5) if np.copysign(1.0, q[i]) != np.copysign(1.0, seed[i])]
    return 3 not in turned and bool(np.all(np.abs(q[turned]) < CROSSING_RAD))


def _rigid(T: np.ndarray) -> pin.SE3:
    """Returns the pose with its rotation free of rounding, which the logarithm would take for an error."""
    return pin.SE3(pin.Quaternion(T[:3, :3]).normalized(), T[:3, 3])
