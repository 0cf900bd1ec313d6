"""Forward and inverse kinematics of the arm, in closed form."""

from kuka_control.kinematics.chain import forward, jacobian
from kuka_control.kinematics.elbow_circle import Branch
from kuka_control.kinematics.inverse import IkFailure, IkResult, Kinematics

__all__ = ["Branch", "IkFailure", "IkResult", "Kinematics", "forward", "jacobian"]
