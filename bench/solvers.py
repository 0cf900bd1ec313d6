"""Numerical inverse kinematics to compare the closed form with: damped least squares by hand, and KDL's solvers.

Both take the arm from the rig's URDF. Poses are those of the flange in the base [m], joints in rad.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from common.frames import FLANGE
from rig_simulation.files import read_urdf

ARM = [f"kuka/joint_{k}" for k in range(1, 8)]
ITERATIONS = 200
TOLERANCE = 1e-6
MAX_STEP_RAD = 0.5
BIAS = 1e-8


def arm_model(robot: str, flange: str) -> pin.Model:
    """Returns the arm without the hand's joints."""
    full = pin.buildModelFromXML(read_urdf(robot, flange))
    others = [full.getJointId(name) for name in full.names[1:] if name not in ARM]
    return pin.buildReducedModel(full, others, pin.neutral(full))


class DampedLeastSquares:
    """Closed-loop inverse kinematics: Levenberg-Marquardt steps, projected onto the joint ranges.

    The damping is half the squared error plus a bias (Sugihara, IEEE Transactions on Robotics 27, 2011), the Jacobian
    is that of the logarithm, so that the last steps are Newton's. A joint that a step would carry beyond its range is
    held there, and the step is calculated again without it.
    """

    def __init__(self, model: pin.Model) -> None:
        self._model, self._data = model, model.createData()
        self._flange = model.getFrameId(FLANGE)
        self.lower, self.upper = model.lowerPositionLimit, model.upperPositionLimit
        self.iterations: list[int] = []

    def forward(self, q: np.ndarray) -> pin.SE3:
        """Returns the pose of the flange."""
        pin.forwardKinematics(self._model, self._data, q)
        return pin.updateFramePlacement(self._model, self._data, self._flange)

    def solve(self, target: pin.SE3, seed: np.ndarray) -> np.ndarray | None:
        """Returns joints, or None after ITERATIONS steps; one attempt, no restart."""
        lower, upper = self.lower, self.upper
        q = seed.copy()
        for count in range(ITERATIONS):
            M = self.forward(q).actInv(target)
            error = pin.log6(M).vector
            if error @ error < TOLERANCE**2:
                self.iterations.append(count)
                return q
            J = pin.Jlog6(M.inverse()) @ pin.computeFrameJacobian(self._model, self._data, q, self._flange, pin.LOCAL)
            damping = (0.5 * error @ error + BIAS) * np.eye(6)
            free = np.ones(7)
            for _ in range(7):
                step = free * (J.T @ np.linalg.solve((J * free) @ J.T + damping, error))
                step *= min(1.0, MAX_STEP_RAD / max(np.abs(step).max(), 1e-12))
                held = ((q + step > upper) | (q + step < lower)) & ((q >= upper) | (q <= lower)) & (free > 0.0)
                if not held.any():
                    break
                free[held] = 0.0
            q = np.clip(q + step, lower, upper)
        self.iterations.append(ITERATIONS)
        return None


class Kdl:
    """KDL's solvers for the same arm: `newton_raphson` (NR_JL, keeps to the joint ranges), `levenberg_marquardt` (LMA).

    Raises:
        ImportError: PyKDL (Debian's python3-pykdl) is not installed.
    """

    def __init__(self, model: pin.Model) -> None:
        import PyKDL as kdl

        self._kdl = kdl
        frames = [self.frame(placement) for placement in list(model.jointPlacements)[1:]]
        frames.append(self.frame(model.frames[model.getFrameId(FLANGE)].placement))
        self._chain = kdl.Chain()
        self._chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.Fixed), frames[0]))
        for tip in frames[1:]:
            self._chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.RotZ), tip))
        # KDL keeps bare references: what a solver is made of has to live as long as it does.
        self._forward = kdl.ChainFkSolverPos_recursive(self._chain)
        self._velocity = kdl.ChainIkSolverVel_pinv(self._chain)
        self._limits = self.joints(model.lowerPositionLimit), self.joints(model.upperPositionLimit)
        self._nr = kdl.ChainIkSolverPos_NR_JL(
            self._chain, *self._limits, self._forward, self._velocity, ITERATIONS, TOLERANCE
        )
        self._lma = kdl.ChainIkSolverPos_LMA(self._chain, np.ones(6), TOLERANCE, ITERATIONS)

    def newton_raphson(self, target, seed):
        """Returns joints as KDL's array, or None."""
        return self._solve(self._nr, target, seed)

    def levenberg_marquardt(self, target, seed):
        """Returns joints as KDL's array, perhaps whole turns and more out of range, or None."""
        return self._solve(self._lma, target, seed)

    def frame(self, pose: pin.SE3):
        """Returns the pose as KDL has it."""
        R = self._kdl.Rotation(*np.asarray(pose.rotation).ravel().tolist())
        return self._kdl.Frame(R, self._kdl.Vector(*np.asarray(pose.translation).tolist()))

    def joints(self, q: np.ndarray):
        """Returns the joints as KDL has them."""
        array = self._kdl.JntArray(len(q))
        for i, angle in enumerate(q):
            array[i] = float(angle)
        return array

    def _solve(self, solver, target, seed):
        q = self._kdl.JntArray(7)
        return q if solver.CartToJnt(seed, target, q) >= 0 else None
