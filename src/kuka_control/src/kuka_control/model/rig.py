"""The arm with its tool, its workspace and its home position, put together from the configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from common.config import parse
from common.errors import ConfigError
from common.mounting import MountingFrame, mounting_frame
from iiwa_kinematics import PTP_M_PER_S, Ball, Kinematics, RobotModel, kinematics_of, ptp_velocity, robot_model
from kuka_control.model.config import ControllerConfig, DhDeviations, RealTimeConfig, neighbours
from kuka_control.model.home_pose import Home, HomeError, custom_home, home_pose
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.robot_shape import Opening, enclosing_ball, finger_tips
from kuka_control.model.target import TargetChain
from kuka_control.model.tool_load import ToolLoad
from kuka_control.model.workspace import Workspace


@dataclass(frozen=True)
class Rig:
    """The arm with its tool, where it may go and where its home is; built before anything moves."""

    model: RobotModel  # the arm
    T_flange_tool: np.ndarray  # the tool, shape (4, 4) [m]
    mounting: MountingFrame  # the operator's directions in the base frame
    kinematics: Kinematics  # of the arm with its tool
    workspace: Workspace  # of the tool point
    home: Home  # the home position
    chain: TargetChain  # from the desired tool frame to joints
    load: ToolLoad  # what the tool weighs
    obstacles: tuple[ConvexBody, ...] | None = None  # what the collision guard knows besides table and base
    ring: bool = False  # whether the marker board's ring is behind the hand
    ptp_speed: float = PTP_M_PER_S  # of the arm's fastest point in a PTP motion [m/s]

    @classmethod
    def of(
        cls,
        config: ControllerConfig,
        dh: DhDeviations | None = None,
        obstacles: tuple[ConvexBody, ...] | None = None,
        lifted: bool = False,
    ) -> Rig:
        """Returns the rig that a configuration describes; `dh`, `obstacles`: what the files that it names hold;
        `lifted`: the bounds of the workspace do not act. Raises ValueError: a named file is not handed in; HomeError:
        no home position in reach and in the workspace."""
        if config.dh_parameters and dh is None:
            raise ValueError(f"what {config.dh_parameters} says has to be read and handed in")
        model = robot_model(config.robot, config.flange)
        T_flange_tool = config.T_flange_tool
        mounting = mounting_frame(config.center_line, config.mounting)
        deviations = None if dh is None else dh.parameters
        kinematics = kinematics_of(model, T_flange_tool, deviations, float(np.radians(config.elbow_preference)))
        workspace = workspace_of(config, lifted)
        if config.use_home_pos:
            home = custom_home(kinematics, workspace, np.radians(config.home_pos))
        else:
            home = home_pose(kinematics, workspace, mounting)
        chain = TargetChain(home.centre, workspace, kinematics)
        load = ToolLoad(kinematics, config.tool_mass, config.tool_center_of_mass, mounting.up)
        fastest = min(PTP_M_PER_S, config.tcp_speed) if isinstance(config, RealTimeConfig) else PTP_M_PER_S
        rest = model, T_flange_tool, mounting, kinematics, workspace, home, chain, load, obstacles
        return cls(*rest, config.marker_ring, fastest)

    def ptp_velocity(self, start: np.ndarray, goal: np.ndarray, velocity: float) -> float:
        """Returns the fraction of full joint speed of a PTP motion: `velocity`, or less for an arm too fast. `start`
        and `goal` are joints of shape (7,) [rad]. The speed limit `ptp_speed` holds at any opening of the hand."""
        return ptp_velocity(self.model, self.carried(None), start, goal, velocity, self.ptp_speed)

    def carried(self, opening: Opening | None) -> tuple[Ball, ...]:
        """Returns what the flange carries: tool point, finger tips, and what is mounted there by the obstacles'
        file. Without an opening the fingers may be anywhere."""
        tips = finger_tips(self.model, self.ring, opening)
        mounted = (enclosing_ball(body, self.model) for body in self.obstacles or () if body.link)
        x, y, z = self.T_flange_tool[:3, 3].tolist()
        return ((x, y, z, 0.0), *tips, *mounted)

    def T_base_flange(self, T_base_tool: np.ndarray) -> np.ndarray:
        """Returns the flange, shape (4, 4) [m], of a tool frame."""
        return T_base_tool @ self.kinematics.T_tool_flange


def workspace_of(config: ControllerConfig, lifted: bool = False) -> Workspace:
    """Returns the workspace that a configuration describes; `lifted`: its bounds do not act."""
    return Workspace(
        center_line=config.center_line,
        opening_angle=float(np.radians(config.opening_angle)),
        z_lower=config.z_lower_limit,
        z_upper=config.z_upper_limit,
        inner_sphere=config.inner_sphere_limit,
        outer_sphere=config.outer_sphere_limit,
        joint_2_height=robot_model(config.robot, config.flange).base_shoulder,
        lifted=lifted,
    )


def checked_rig(
    values: Mapping, prefix: str = "", read_dh: Callable[[ControllerConfig], DhDeviations | None] = lambda config: None
) -> tuple[ControllerConfig, Rig]:
    """Returns the parameters of either controller, and the arm with workspace and home that they describe. In
    messages `prefix` stands before each key, such as "kuka/"; `read_dh` reads the file that dh_parameters names.
    Raises ConfigError: with all faults, one sentence each."""
    config = parse(ControllerConfig, values, prefix, others=neighbours(ControllerConfig))
    try:
        return config, Rig.of(config, read_dh(config))
    except HomeError as error:
        raise ConfigError([str(error)]) from error
