"""The control loops and their limits, put together from the configuration and the rig."""

from __future__ import annotations

import numpy as np

from kuka_control.limits.motion_limits import MotionLimits, SpeedLimits, Unlimited
from kuka_control.limits.speed_change import ShapeLimits
from kuka_control.limits.workspace_brake import WorkspaceBrake
from kuka_control.loop.goal_stream import GoalStreamSettings
from kuka_control.loop.ptp_loop import PtpLoop, PtpSettings
from kuka_control.loop.real_time_loop import RealTimeLoop, RealTimeSettings
from kuka_control.model.config import PtpConfig, RealTimeConfig
from kuka_control.model.rig import Rig

RANGE_MARGIN_RAD = float(np.radians(0.1))
"""Servo goals keep this distance to the ends of the joint ranges, where the robot's controller would end servo mode."""


def real_time_loop(config: RealTimeConfig, rig: Rig) -> RealTimeLoop:
    """Returns the real-time control loop."""
    goals = GoalStreamSettings(
        joint_speeds=config.joint_speed * rig.model.max_speed,
        tool_speed=config.tcp_speed,
        shaped=config.shaping != "none",
        lower=rig.model.lower + RANGE_MARGIN_RAD,
        upper=rig.model.upper - RANGE_MARGIN_RAD,
    )
    settings = RealTimeSettings(
        q_home=rig.home.q,
        time_out=config.time_out,
        velocity_home=config.velocity_ptp_slow,
        velocity_return=config.velocity_ptp_fast,
        servo_law=config.servo_law,
        goals=goals,
    )
    return RealTimeLoop(settings, rig.chain, motion_limits(config, rig) if goals.shaped else Unlimited())


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
