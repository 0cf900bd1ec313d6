"""Forward and inverse kinematics of the arm: in closed form, and refined for an arm that was calibrated."""

from kuka_control.kinematics.calibrated import CalibratedKinematics, kinematics_of
from kuka_control.kinematics.chain import forward, jacobian
from kuka_control.kinematics.dh import DhDeviations
from kuka_control.kinematics.elbow_circle import Branch
from kuka_control.kinematics.inverse import IkFailure, IkResult, Kinematics

__all__ = [
    "Branch",
    "CalibratedKinematics",
    "DhDeviations",
    "IkFailure",
    "IkResult",
    "Kinematics",
    "forward",
    "jacobian",
    "kinematics_of",
]
