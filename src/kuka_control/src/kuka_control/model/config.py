"""The parameters of the two controllers under `kuka/`, each with its unit and range.

Angles in the files are in degrees; properties give them in radians. Whether the home position can be reached is
checked where it is calculated: home_pose.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from common.config import choice, flag, integer, number, path, text, vector
from common.mounting import ToolConfig, mounting_field
from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, ROBOTS, robot_model
from kuka_control.model.workspace import workspace_faults

UPLOADED = ("ws_center", "joints_home")
"""Keys under `kuka/` that the controller itself writes."""


@dataclass(frozen=True)
class RobotAddress(ToolConfig):
    """The arm, its tool, and where its controller listens."""

    robot: str = choice(*ROBOTS, doc="the arm")
    flange: str = choice(*FLANGE_HEIGHTS, doc="the media flange on the arm")
    ip: str = text(doc="address of the robot's controller")
    port: int = integer(low=1, high=65535, doc="TCP port of the toolbox server on the robot's controller")


@dataclass(frozen=True)
class ControllerConfig(RobotAddress):
    """The parameters of both controllers."""

    dh_parameters: str = path(doc="file of a calibrated arm's parameters; empty: as in its data sheet", absent="")
    center_line: np.ndarray = vector(3, doc="horizontal direction from the base to the middle of the workspace")
    opening_angle: float = number("deg", above=0.0, below=180.0, doc="angle between the workspace's side planes")
    z_lower_limit: float = number("m", above=0.1, doc="lowest height of the tool")
    z_upper_limit: float = number("m", below=1.14, doc="greatest height of the tool")
    inner_sphere_limit: float = number("m", above=0.4, doc="smallest distance of the tool from joint 2")
    outer_sphere_limit: float = number("m", below=0.8, doc="greatest distance of the tool from joint 2")
    mounting: np.ndarray = mounting_field()
    time_out: float = number("s", above=0.0, doc="go home after this long without a new desired tool frame")
    home_pos: np.ndarray = vector(7, "deg", low=-180.0, high=180.0, doc="joints of a home position of one's own")
    use_home_pos: bool = flag("whether home_pos is used instead of the calculated home position")
    elbow_preference: float = number(
        "deg",
        low=-90.0,
        high=90.0,
        absent=0.0,
        doc="arm angle to which the elbow slowly returns while the tool moves; 0: up, positive: right",
    )
    rate_joints: float = number("Hz", low=1.0, high=250.0, doc="how often joint_states are published")
    rate_state: float = number("Hz", low=1.0, high=100.0, doc="how often torques, force, pose and flags are published")

    def faults(self) -> list[str]:
        """Returns the faults that no single parameter can show, one sentence each."""
        return super().faults() + self.faults_among(vars(self))

    @staticmethod
    def faults_among(read: Mapping[str, Any]) -> list[str]:
        """Returns the faults of parameters together, one sentence each; `read` has those that are valid alone."""
        angle = read.get("opening_angle")
        mounted = "robot" in read and "flange" in read
        return workspace_faults(
            read.get("center_line"),
            None if angle is None else float(np.radians(angle)),
            read.get("z_lower_limit"),
            read.get("z_upper_limit"),
            read.get("inner_sphere_limit"),
            read.get("outer_sphere_limit"),
            robot_model(read["robot"], read["flange"]).base_shoulder if mounted else None,
        )

    @property
    def opening_angle_rad(self) -> float:
        """The opening angle [rad]."""
        return float(np.radians(self.opening_angle))


@dataclass(frozen=True)
class RealTimeConfig(ControllerConfig):
    """The parameters of the real-time controller."""

    velocity_ptp_slow: float = number(above=0.0, below=1.0, doc="fraction of the full joint speed to home and to zero")
    velocity_ptp_fast: float = number(above=0.0, below=1.0, doc="fraction of the full joint speed at pick-up, time-out")
    rate_servo: float = number("Hz", low=50.0, high=1000.0, doc="servo goals per second, whatever the frames' rate")
    servo_law: str = choice("none", "lts", doc="servo law of the robot's controller, for which goals are made")
    shaping: str = choice("ruckig", "none", doc="whether the stream keeps the limits, or each target is a goal")
    joint_speed: float = number(above=0.0, high=1.0, doc="limit of the stream, fraction of the data sheet's speeds")
    tcp_speed: float = number("m/s", above=0.0, below=0.8, doc="limit of the stream; at 0.8 the robot stops the arm")
    joint_acceleration: float = number("rad/s^2", low=1.0, high=16.0, doc="limit of the stream, slowest joint")
    joint_jerk: float = number("rad/s^3", low=20.0, high=2000.0, doc="limit of the stream, slowest joint")


@dataclass(frozen=True)
class PtpConfig(ControllerConfig):
    """The parameters of the PTP controller."""

    velocity_ptp: float = number(above=0.0, below=1.0, doc="fraction of the full joint speed of every motion")
    joints_thresh: float = number("deg", low=0.0, doc="smaller joint steps are not executed")

    @property
    def joints_thresh_rad(self) -> float:
        """The smallest joint step that is executed [rad]."""
        return float(np.radians(self.joints_thresh))


def neighbours(schema: type[ControllerConfig]) -> tuple[str, ...]:
    """Returns the keys that may stand beside `schema`'s own: the controller's uploads, and the other controller's keys
    when both parameter files were loaded one after the other on the same master."""
    own = {f.name for f in fields(schema)}
    both = (f.name for other in (RealTimeConfig, PtpConfig) for f in fields(other))
    return UPLOADED + tuple(name for name in both if name not in own)
