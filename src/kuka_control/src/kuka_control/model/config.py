"""The parameters of the two controllers under `kuka/`, each with its unit and range, and the file of a calibrated
arm. Angles in the files are in degrees. Whether the home position can be reached is checked where it is calculated:
home_pose.py."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from common.config import choice, flag, integer, names, number, parse, path, text, vector
from common.mounting import ToolConfig, mounting_field
from common.simulated import simulated_field
from iiwa_kinematics import FLANGE_HEIGHTS, ROBOTS, DhParameters, robot_model
from kuka_control.model.admittance import AdmittanceSettings, stability_fault
from kuka_control.model.workspace import workspace_faults

UPLOADED = ("ws_center", "joints_home", "rotation_home", "running")  # keys under `kuka/` that a controller writes
MAX_LENGTH_MM = 5.0  # a larger deviation is a wrong measurement, or the file has another unit or convention
MAX_ANGLE_DEG = 1.0  # likewise
MOST_DAMPING = 5000.0  # [Ns/m]
OPTIONS = ("robot", "flange", "ip", "port", "tool_length")  # keys that may be given as options too


@dataclass(frozen=True)
class RobotAddress(ToolConfig):
    """The arm, its tool, and where its controller listens."""

    robot: str = choice(*ROBOTS, doc="the arm")
    flange: str = choice(*FLANGE_HEIGHTS, doc="the media flange on the arm")
    ip: str = text(doc="address of the robot's controller")
    port: int = integer(low=1, high=65535, doc="TCP port of the toolbox server on the robot's controller")

    @property
    def on_this_machine(self) -> bool:
        """Whether the address is a loopback one, as that of a simulated arm is."""
        try:
            return ipaddress.ip_address(self.ip).is_loopback
        except ValueError:
            return self.ip == "localhost"


@dataclass(frozen=True)
class ControllerConfig(RobotAddress):
    """The parameters of both controllers."""

    dh_parameters: str = path(doc="file of a calibrated arm's parameters; empty: as in its data sheet", absent="")
    center_line: np.ndarray = vector(3, doc="horizontal direction from the base to the middle of the workspace")
    opening_angle: float = number("deg", above=0.0, below=180.0, doc="angle between the workspace's side planes")
    z_lower_limit: float = number("m", above=0.1, below=1.14, doc="lowest height of the tool, below z_upper_limit")
    z_upper_limit: float = number(
        "m",
        above=0.1,
        below=1.14,
        doc="greatest height of the tool, at most the top of the outer sphere: joint 2 (0.34 m high on the 7 R800, "
        "0.36 m on the 14 R820) + outer_sphere_limit, so 1.04 or 1.06 m unless that is changed too. The calculated "
        "home, half way between the z limits, must be in reach",
    )
    inner_sphere_limit: float = number(
        "m", above=0.4, below=0.8, doc="smallest distance of the tool from joint 2, below outer_sphere_limit"
    )
    outer_sphere_limit: float = number("m", above=0.4, below=0.8, doc="greatest distance of the tool from joint 2")
    mounting: np.ndarray = mounting_field()
    time_out: float = number("s", above=0.0, doc="go home after this long without a new desired tool frame")
    home_pos: np.ndarray = vector(7, "deg", low=-180.0, high=180.0, doc="joints of a home position of one's own")
    use_home_pos: bool = flag("whether home_pos is used instead of the calculated home position")
    named_positions: str = path(
        doc="file of the positions that programs name for kuka/move; empty: joint_configurations.yaml", absent=""
    )
    tool_mass: float = number(
        "kg",
        low=0.0,
        high=5.0,
        absent=0.0,
        doc="of what is on the flange, whose weight kuka/joint_torques_contact leaves out",
    )
    tool_center_of_mass: np.ndarray = vector(
        3, "m", low=-1.0, high=1.0, absent=(0.0, 0.0, 0.0), doc="centre of that mass in the flange frame"
    )
    flange_force_raw: bool = flag(
        "whether kuka/flange_force and flange_torque are as the robot's controller reports them, with the weight of "
        "the tool and of what the hand holds",
        absent=False,
    )
    elbow_preference: float = number(
        "deg",
        low=-90.0,
        high=90.0,
        absent=0.0,
        doc="arm angle to which the elbow slowly returns while the tool moves; 0: up, positive: right",
    )
    collision_guard: bool = flag("whether stream and PTP motions keep a distance from known bodies", absent=False)
    guard_margin: float = number("m", low=0.005, high=0.2, absent=0.03, doc="distance that the collision guard keeps")
    guard_obstacles: str = path(doc="file of obstacles for the collision guard; empty: table and base only", absent="")
    allow_contact: tuple[str, ...] = names(doc="bodies that the fingers may touch or come near", absent=("table",))
    ptp_contact_torque: float = number(
        "Nm",
        low=0.0,
        high=30.0,
        absent=0.0,
        doc="a PTP motion ends where an external joint torque leaves the range from zero to that of hand and load "
        "by this; 0: never",
    )
    robot_server: str = choice(
        "toolbox",
        "leap_rig",
        absent="toolbox",
        doc="application on the robot's controller: the toolbox's, or LeapRigServer of src/modules/sunrise_application",
    )
    watchdog_brake: float = number(
        "s",
        low=0.05,
        high=2.0,
        absent=0.2,
        doc="with leap_rig: the robot brakes, or stops its motion, when this controller is silent for longer",
    )
    watchdog_end: float = number(
        "s", above=0.05, high=60.0, absent=10.0, doc="with leap_rig: servo mode ends then; above watchdog_brake"
    )
    marker_ring: bool = flag("whether the marker board's ring is between flange and hand", absent=False)
    rate_joints: float = number("Hz", low=1.0, high=250.0, doc="how often joint_states are published")
    rate_state: float = number("Hz", low=1.0, high=100.0, doc="how often torques, force, pose and flags are published")

    @property
    def unguided(self) -> str | None:
        """Why no hand can guide the arm, a part of a sentence."""
        return None if self.tool_mass > 0.0 else "tool_mass is 0, and the arm would sink"

    @property
    def stiff_because(self) -> str | None:
        """Why servo modes cannot begin soft, a part of a sentence."""
        return self.unguided

    def faults(self) -> list[str]:
        """Returns the faults that no single parameter can show, one sentence each."""
        return super().faults() + self.faults_among(vars(self))

    @staticmethod
    def faults_among(read: Mapping[str, Any]) -> list[str]:
        """Returns the faults of parameters together, one sentence each; `read` has those that are valid alone."""
        angle = read.get("opening_angle")
        brake, end = read.get("watchdog_brake"), read.get("watchdog_end")
        silent = brake is not None and end is not None and not end > brake
        watchdog = [f"watchdog_end is {end:g} s, but must be above watchdog_brake, {brake:g} s."] if silent else []
        mounted = "robot" in read and "flange" in read
        return watchdog + workspace_faults(
            read.get("center_line"),
            None if angle is None else float(np.radians(angle)),
            read.get("z_lower_limit"),
            read.get("z_upper_limit"),
            read.get("inner_sphere_limit"),
            read.get("outer_sphere_limit"),
            robot_model(read["robot"], read["flange"]).base_shoulder if mounted else None,
        )


@dataclass(frozen=True)
class RealTimeConfig(ControllerConfig):
    """The parameters of the real-time controller."""

    velocity_ptp_slow: float = number(above=0.0, below=1.0, doc="fraction of the full joint speed to home and to zero")
    velocity_ptp_fast: float = number(
        above=0.0, below=1.0, doc="fraction of the full joint speed to the pick-up pose and back home"
    )
    rate_servo: float = number("Hz", low=50.0, high=1000.0, doc="servo goals per second, whatever the frames' rate")
    servo_law: str = choice(
        "auto", "none", "lts", doc="servo law of the robot's controller, for which goals are made; auto: as identified"
    )
    shaping: str = choice(
        "ruckig", "none", doc="the stream keeps the limits; none, only without collision_guard: each target is a goal"
    )
    joint_speed: float = number(above=0.0, high=1.0, doc="limit of the stream, fraction of the data sheet's speeds")
    tcp_speed: float = number("m/s", above=0.0, below=0.8, doc="limit of all points of the arm; stopped at 0.8")
    joint_acceleration: float = number("rad/s^2", low=1.0, high=16.0, doc="limit of the stream, slowest joint")
    compliance: str = choice(
        *("stiff", "soft"),
        absent="stiff",
        doc="soft, only with leap_rig and tool_mass: in servo mode the tool yields to forces; kuka/soft changes it",
    )
    soft_stiffness: float = number("N/m", low=50.0, high=5000.0, absent=500.0, doc="of a soft tool along its axes")
    soft_turning_stiffness: float = number(
        "Nm/rad", low=5.0, high=300.0, absent=100.0, doc="of a soft tool about its axes"
    )
    soft_damping: float = number(low=0.1, high=1.0, absent=0.7, doc="of a soft tool, fraction of the critical one")
    soft_force: float = number("N", low=1.0, high=200.0, absent=40.0, doc="servo mode ends above it along an axis")
    soft_moment: float = number("Nm", low=0.1, high=50.0, absent=20.0, doc="servo mode ends above it about an axis")
    soft_path: float = number(
        "m", low=0.001, high=0.5, absent=0.2, doc="servo mode ends where the tool is farther from its path"
    )
    admittance: bool = flag(
        "whether a stiff tool that follows gives way to kuka/flange_force; needs tool_mass, and shaping ruckig",
        absent=False,
    )
    admittance_mass: float = number("kg", low=1.0, high=50.0, absent=8.0, doc="of what gives way")
    admittance_damping: float = number(
        "Ns/m", low=50.0, high=MOST_DAMPING, absent=1200.0, doc="of what gives way; too little swings at a stiff body"
    )
    admittance_stiffness: float = number(
        "N/m", low=50.0, high=5000.0, absent=500.0, doc="of the spring that brings the tool back"
    )
    admittance_contact: float = number(
        "N/m", low=100.0, high=1e5, absent=10000.0, doc="of the stiffest body that the tool may touch"
    )
    admittance_path: float = number("m", low=0.001, high=0.2, absent=0.05, doc="farthest that the tool gives way")
    joint_jerk: float = number("rad/s^3", low=20.0, high=2000.0, doc="limit of the stream, slowest joint")

    @staticmethod
    def faults_among(read: Mapping[str, Any]) -> list[str]:
        faults = ControllerConfig.faults_among(read)
        if read.get("collision_guard") and read.get("shaping") == "none":
            faults.append(
                "collision_guard is true, but guards no stream with shaping none; use shaping ruckig, or switch it off."
            )
        if read.get("compliance") == "soft" and read.get("robot_server") == "toolbox":
            faults.append("compliance is soft, but the toolbox knows stiff only; set robot_server to leap_rig.")
        elif read.get("compliance") == "soft" and read.get("tool_mass") == 0.0:
            faults.append("compliance is soft, but tool_mass is 0: a soft arm would sink; say what is on the flange.")
        return faults + (_admittance_faults(read) if read.get("admittance") else [])

    @property
    def stiff_because(self) -> str | None:
        return "admittance is true" if self.admittance else super().stiff_because

    @property
    def gives_way(self) -> AdmittanceSettings | None:
        """How the tool gives way to a force; None: it does not."""
        return _admittance(vars(self)) if self.admittance else None


def _admittance(read: Mapping[str, Any]) -> AdmittanceSettings:
    mass, damping, stiffness, path = (read[f"admittance_{key}"] for key in ("mass", "damping", "stiffness", "path"))
    return AdmittanceSettings(mass, damping, stiffness, farthest=path)


def _admittance_faults(read: Mapping[str, Any]) -> list[str]:
    faults = []
    if read.get("compliance") == "soft":
        faults.append("admittance is true, but compliance is soft; use one of them.")
    if read.get("tool_mass") == 0.0:
        faults.append("admittance is true, but tool_mass is 0: its weight would count as a force; say what it is.")
    if read.get("shaping") == "none":
        faults.append("admittance is true, but shaping is none; use shaping ruckig.")
    numbers = {f"admittance_{key}" for key in ("mass", "damping", "stiffness", "path", "contact")}
    if numbers <= read.keys():
        swings = stability_fault(_admittance(read), read["admittance_contact"], MOST_DAMPING)
        faults += [] if swings is None else [swings]
    return faults


@dataclass(frozen=True)
class PtpConfig(ControllerConfig):
    """The parameters of the PTP controller."""

    velocity_ptp: float = number(above=0.0, below=1.0, doc="fraction of the full joint speed of every motion")
    joints_thresh: float = number("deg", low=0.0, doc="smaller joint steps are not executed")


def neighbours(schema: type[ControllerConfig]) -> tuple[str, ...]:
    """Returns the keys that may stand beside `schema`'s own: the controller's uploads, and the other controller's
    keys when both parameter files were loaded one after the other on the same master."""
    own = {f.name for f in fields(schema)}
    both = (f.name for other in (RealTimeConfig, PtpConfig) for f in fields(other))
    return UPLOADED + tuple(name for name in both if name not in own)


@dataclass(frozen=True)
class DhDeviations:
    """The file of a calibrated arm: calibrated less nominal parameters of joints 1 to 7, each of shape (7,)."""

    robot: str = choice(*ROBOTS, doc="the arm that was measured")
    serial: str = text(doc="its serial number")
    date: str = text(doc="when it was measured, in quotes")
    delta_a: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the axis x")
    delta_alpha: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="about the axis x")
    delta_d: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the joint's axis z")
    delta_theta: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="zero of the joint")
    simulated: bool | None = simulated_field()

    @property
    def parameters(self) -> DhParameters:
        """The deviations in m and rad."""
        alpha, theta = np.radians(self.delta_alpha), np.radians(self.delta_theta)
        return DhParameters(1e-3 * self.delta_a, alpha, 1e-3 * self.delta_d, theta)


def robot_address(values: object, given: Mapping, prefix: str = "") -> RobotAddress:
    """Returns the robot that the parameters of either controller describe; ConfigError: with all faults. Options
    `given` (None: not) override the parameters; a given tool_length is the whole tool. In messages `prefix` stands
    before each key."""
    changes = {key: value for key, value in given.items() if value is not None}
    if "tool_length" in changes:
        changes["use_tool_transform"] = False
    merged: Any = {**values, **changes} if isinstance(values, Mapping) else values
    controllers = (ControllerConfig, RealTimeConfig, PtpConfig)
    others = {field.name for schema in controllers for field in fields(schema)} | set(neighbours(ControllerConfig))
    return parse(RobotAddress, merged, prefix, others=others - {field.name for field in fields(RobotAddress)})
