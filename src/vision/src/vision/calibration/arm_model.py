"""Kinematics of the arm for the planning of calibration views: link positions, and joints for a wanted flange pose. The
model is that of the robot description. The inverse takes damped Newton steps from a given seed and keeps its branch, so
that motions between the views stay short."""

from __future__ import annotations

import copy

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from common.frames import FLANGE
from common.poses import read_only

JOINTS = [f"kuka/joint_{i}" for i in range(1, 8)]
SHOULDER, ELBOW, WRIST = "kuka/joint_2", "kuka/joint_4", "kuka/joint_6"
MARGIN_RAD = np.radians(5.0)  # distance of the views from the ends of the joint ranges
SHIFT_TOLERANCE_M = 2e-3  # loose: the arm measures its pose in the view


class ArmModel:
    """Kinematics of a seven-joint arm; `urdf` is the text of the robot description."""

    def __init__(self, urdf: str) -> None:
        full = pin.buildModelFromXML(urdf)
        others = [i for i, name in enumerate(full.names) if i > 0 and name not in JOINTS]
        self._model = pin.buildReducedModel(full, others, pin.neutral(full))
        self._data = self._model.createData()
        self._frames = [self._model.getFrameId(name) for name in (SHOULDER, ELBOW, WRIST)]
        self._flange = self._model.getFrameId(FLANGE)
        self.lower = read_only(self._model.lowerPositionLimit + MARGIN_RAD)
        self.upper = read_only(self._model.upperPositionLimit - MARGIN_RAD)

    def bent(self, shift: float, turn: float, rng: np.random.Generator) -> ArmModel:
        """Returns an arm of this kind that was not built exactly: each joint is displaced along and turned about each
        axis by errors with these standard deviations [m, rad]."""
        other = copy.copy(self)
        other._model = self._model.copy()
        for joint in range(1, other._model.njoints):
            error = pin.SE3(pin.exp3(turn * rng.normal(size=3)), shift * rng.normal(size=3))
            other._model.jointPlacements[joint] = other._model.jointPlacements[joint] * error
        other._data = other._model.createData()
        return other

    def flange(self, q: ArrayLike) -> np.ndarray:
        """Returns T_base_flange, shape (4, 4) [m], for the joints q, shape (7,) [rad]."""
        pin.framesForwardKinematics(self._model, self._data, np.asarray(q, dtype=float))
        return self._data.oMf[self._flange].homogeneous

    def spine(self, q: ArrayLike) -> np.ndarray:
        """Returns the positions of base, shoulder, elbow, wrist and flange, shape (5, 3) [m]."""
        T = self.flange(q)
        joints = [self._data.oMf[frame].translation for frame in self._frames]
        return np.array([np.zeros(3), *joints, T[:3, 3]])

    def joints_for(self, T_base_flange: np.ndarray, q_seed: ArrayLike) -> np.ndarray | None:
        """Returns joints, shape (7,) [rad], for a flange pose; None if the search from `q_seed` does not converge."""
        max_steps = 60
        damping = 1e-4
        max_step_rad = 0.3
        turn_tolerance_rad = 5e-3  # loose: the arm measures its pose in the view
        goal = pin.SE3(T_base_flange[:3, :3], T_base_flange[:3, 3])
        q = np.clip(np.asarray(q_seed, dtype=float), self.lower, self.upper)
        for _ in range(max_steps):
            pin.computeJointJacobians(self._model, self._data, q)
            pin.updateFramePlacements(self._model, self._data)
            error = pin.log6(self._data.oMf[self._flange].actInv(goal)).vector
            if np.linalg.norm(error[:3]) < SHIFT_TOLERANCE_M and np.linalg.norm(error[3:]) < turn_tolerance_rad:
                return q
            J = pin.getFrameJacobian(self._model, self._data, self._flange, pin.LOCAL)
            step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
            q = np.clip(q + step * min(1.0, max_step_rad / np.max(np.abs(step))), self.lower, self.upper)
        return None
