"""What a controller is made of, put together from its configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.mounting import Directions, directions
from common.poses import inverse
from kuka_control.config import ArmConfig, PtpConfig, RealTimeConfig
from kuka_control.home_pose import Home, custom_home, home_pose
from kuka_control.kinematics import DhDeviations, Kinematics, kinematics_of
from kuka_control.motion_limits import MotionLimits, SpeedLimits, Unlimited
from kuka_control.ptp_loop import PtpLoop, PtpSettings
from kuka_control.real_time_loop import RealTimeLoop, RealTimeSettings
from kuka_control.robot_model import RobotModel, robot_model
from kuka_control.speed_change import ShapeLimits
from kuka_control.target import TargetChain
from kuka_control.workspace import Workspace
from kuka_control.workspace_brake import WorkspaceBrake

RANGE_MARGIN_RAD = float(np.radians(0.1))
"""Servo goals keep this distance to the ends of the joint ranges, where the robot's controller would end servo mode."""


@dataclass(frozen=True)
class Rig:
    """The arm with its tool, where it may go and where its home is; built before anything moves.

    Attributes:
        model: the arm.
        T_flange_tool: the tool, shape (4, 4) [m].
        bearings: which way is up and ahead, after the arm's mounting.
        kinematics: of the arm with its tool.
        workspace: of the tool point.
        home: the home position.
        chain: from the desired tool frame to joints.
    """

    model: RobotModel
    T_flange_tool: np.ndarray
    bearings: Directions
    kinematics: Kinematics
    workspace: Workspace
    home: Home
    chain: TargetChain

    @classmethod
    def of(cls, config: ArmConfig, dh: DhDeviations | None = None) -> Rig:
        """Returns the rig that a configuration describes.

        Args:
            config: the parameters.
            dh: what the file says that the parameter dh_parameters names; None if it names none.

        Raises:
            ValueError: a file is named, but not handed in.
            HomeError: the home position cannot be reached or lies outside the workspace.
        """
        if config.dh_parameters and dh is None:
            raise ValueError(f"what {config.dh_parameters} says has to be read and handed in")
        model = robot_model(config.robot, config.flange)
        T_flange_tool = config.T_flange_tool
        bearings = directions(config.center_line, config.mounting)
        kinematics = kinematics_of(model, T_flange_tool, dh, float(np.radians(config.elbow_preference)))
        workspace = Workspace(
            center_line=config.center_line,
            opening_angle=config.opening_angle_rad,
            z_lower=config.z_lower_limit,
            z_upper=config.z_upper_limit,
            inner_sphere=config.inner_sphere_limit,
            outer_sphere=config.outer_sphere_limit,
            joint_2_height=model.base_shoulder,
        )
        if config.use_home_pos:
            home = custom_home(kinematics, workspace, np.radians(config.home_pos))
        else:
            home = home_pose(kinematics, workspace, bearings)
        chain = TargetChain(home.centre, workspace, kinematics)
        return cls(model, T_flange_tool, bearings, kinematics, workspace, home, chain)

    def T_base_flange(self, T_base_tool: np.ndarray) -> np.ndarray:
        """Returns the flange, shape (4, 4) [m], of a tool frame."""
        return T_base_tool @ inverse(self.T_flange_tool)


def real_time_loop(config: RealTimeConfig, rig: Rig) -> RealTimeLoop:
    """Returns the real-time control loop."""
    limits = motion_limits(config, rig)
    settings = RealTimeSettings(
        q_home=rig.home.q,
        time_out=config.time_out,
        velocity_home=config.velocity_ptp_slow,
        velocity_return=config.velocity_ptp_fast,
        servo_joint_speeds=config.joint_speed * rig.model.max_speed,
        servo_tool_speed=config.tcp_speed,
        servo_law=config.servo_law,
        shaped=config.shaping != "none",
        lower=rig.model.lower + RANGE_MARGIN_RAD,
        upper=rig.model.upper - RANGE_MARGIN_RAD,
    )
    return RealTimeLoop(settings, rig.chain, limits if settings.shaped else Unlimited())


def motion_limits(config: RealTimeConfig, rig: Rig) -> MotionLimits:
    """Returns the limits of the stream of servo goals; faster joints change their speed more quickly in proportion."""
    pace = rig.model.max_speed / np.min(rig.model.max_speed)
    acceleration = config.joint_acceleration * pace

    def tool_position(q: np.ndarray) -> np.ndarray:
        return rig.kinematics.forward(q)[:3, 3]

    def tool_jacobian(q: np.ndarray) -> np.ndarray:
        return rig.kinematics.jacobian(q)

    brake = WorkspaceBrake(rig.workspace, tool_position, tool_jacobian, acceleration)
    return MotionLimits(
        SpeedLimits(config.joint_speed * rig.model.max_speed, config.tcp_speed),
        ShapeLimits(acceleration, config.joint_jerk * pace),
        rig.model.lower + RANGE_MARGIN_RAD,
        rig.model.upper - RANGE_MARGIN_RAD,
        tool_position,
        brake,
    )


def ptp_loop(config: PtpConfig, rig: Rig) -> PtpLoop:
    """Returns the PTP control loop."""
    settings = PtpSettings(
        q_home=rig.home.q,
        time_out=config.time_out,
        velocity_home=config.velocity_ptp,
        velocity_return=config.velocity_ptp,
        joints_thresh=config.joints_thresh_rad,
    )
    return PtpLoop(settings, rig.chain)
