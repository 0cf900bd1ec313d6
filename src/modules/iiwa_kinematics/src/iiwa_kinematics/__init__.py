"""Kinematics of the KUKA LBR iiwa: robot model, forward kinematics, closed-form inverse kinematics. Start with
`robot_model` and `Kinematics`. Where the elbow is chosen: `elbow_choice.py`. Needs numpy alone."""

from iiwa_kinematics.calibrated import CalibratedKinematics, DhParameters, kinematics_of, nominal_parameters
from iiwa_kinematics.chain import Ball, arm_points, forward, jacobian
from iiwa_kinematics.elbow_circle import Branch
from iiwa_kinematics.inverse import IkFailure, IkResult, Kinematics
from iiwa_kinematics.ptp_speed import PTP_M_PER_S, full_speed_time, path_speed, ptp_velocity
from iiwa_kinematics.reach import approached, tilted
from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, ROBOTS, RobotModel, robot_model

__all__ = [
    "FLANGE_HEIGHTS", "PTP_M_PER_S", "ROBOTS", "Ball", "Branch", "CalibratedKinematics", "DhParameters", "IkFailure",
    "IkResult", "Kinematics", "RobotModel", "approached", "arm_points", "forward", "full_speed_time", "jacobian",
    "kinematics_of", "nominal_parameters", "path_speed", "ptp_velocity", "robot_model", "tilted",
]  # fmt: skip
