"""Numerical inverse kinematics to compare the closed form with: KDL's, or damped least squares by hand without it.

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

    name = "DLS"
    how = f"damped least squares in Python on Pinocchio, at most {ITERATIONS} steps, to {TOLERANCE:g}"

    def __init__(self, model: pin.Model) -> None:
        self._model, self._data = model, model.createData()
        self._flange = model.getFrameId(FLANGE)
        self.lower, self.upper = model.lowerPositionLimit, model.upperPositionLimit

    def forward(self, q: np.ndarray) -> pin.SE3:
        """Returns the pose of the flange."""
        pin.forwardKinematics(self._model, self._data, q)
        return pin.updateFramePlacement(self._model, self._data, self._flange)

    def solve(self, target: pin.SE3, seed: np.ndarray) -> np.ndarray | None:
        """Returns joints, or None after ITERATIONS steps; one attempt, no restart."""
        lower, upper = self.lower, self.upper
        q = seed.copy()
        for _ in range(ITERATIONS):
            M = self.forward(q).actInv(target)
            error = pin.log6(M).vector
            if error @ error < TOLERANCE**2:
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
        return None


class Kdl:
    """KDL's Levenberg-Marquardt solver (LMA) for the same arm.

    Raises:
        ImportError: PyKDL (Debian's python3-pykdl) is not installed.
    """

    name = "KDL LMA"
    how = f"KDL in C++, at most {ITERATIONS} steps, to {TOLERANCE:g}; it knows no joint ranges"

    def __init__(self, model: pin.Model) -> None:
        import PyKDL as kdl

        self._kdl = kdl
        frames = [self._frame(placement) for placement in list(model.jointPlacements)[1:]]
        frames.append(self._frame(model.frames[model.getFrameId(FLANGE)].placement))
        self._chain = kdl.Chain()  # KDL keeps a bare reference to it
        self._chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.Fixed), frames[0]))
        for tip in frames[1:]:
            self._chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.RotZ), tip))
        self._solver = kdl.ChainIkSolverPos_LMA(self._chain, np.ones(6), TOLERANCE, ITERATIONS)

    def solve(self, target: pin.SE3, seed: np.ndarray) -> np.ndarray | None:
        """Returns joints within half a turn, or None."""
        start, q = self._kdl.JntArray(7), self._kdl.JntArray(7)
        for i, angle in enumerate(seed.tolist()):
            start[i] = angle
        if self._solver.CartToJnt(start, self._frame(target), q) < 0:
            return None
        return (np.array(list(q)) + np.pi) % (2 * np.pi) - np.pi

    def _frame(self, pose: pin.SE3):
        R = self._kdl.Rotation(*np.asarray(pose.rotation).ravel().tolist())
        return self._kdl.Frame(R, self._kdl.Vector(*np.asarray(pose.translation).tolist()))


def peer_of(model: pin.Model) -> Kdl | DampedLeastSquares:
    """Returns the solver to compare with: KDL's where it is installed."""
    try:
        return Kdl(model)
    except ImportError:
        return DampedLeastSquares(model)
