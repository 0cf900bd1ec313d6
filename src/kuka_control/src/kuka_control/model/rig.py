"""The arm with its tool, its workspace and its home position, put together from the configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.mounting import MountingFrame, mounting_frame
from common.poses import inverse
from iiwa_kinematics import Kinematics, RobotModel, kinematics_of, robot_model
from kuka_control.model.calibration_file import DhDeviations
from kuka_control.model.config import ControllerConfig
from kuka_control.model.home_pose import Home, custom_home, home_pose
from kuka_control.model.target import TargetChain
from kuka_control.model.workspace import Workspace


@dataclass(frozen=True)
class Rig:
    """The arm with its tool, where it may go and where its home is; built before anything moves.

    Attributes:
        model: the arm.
        T_flange_tool: the tool, shape (4, 4) [m].
        mounting: the operator's directions in the base frame.
        kinematics: of the arm with its tool.
        workspace: of the tool point.
        home: the home position.
        chain: from the desired tool frame to joints.
    """

    model: RobotModel
    T_flange_tool: np.ndarray
    mounting: MountingFrame
    kinematics: Kinematics
    workspace: Workspace
    home: Home
    chain: TargetChain

    @classmethod
    def of(cls, config: ControllerConfig, dh: DhDeviations | None = None) -> Rig:
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
        mounting = mounting_frame(config.center_line, config.mounting)
        deviations = None if dh is None else dh.parameters
        kinematics = kinematics_of(model, T_flange_tool, deviations, float(np.radians(config.elbow_preference)))
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
            home = home_pose(kinematics, workspace, mounting)
        chain = TargetChain(home.centre, workspace, kinematics)
        return cls(model, T_flange_tool, mounting, kinematics, workspace, home, chain)

    def T_base_flange(self, T_base_tool: np.ndarray) -> np.ndarray:
        """Returns the flange, shape (4, 4) [m], of a tool frame."""
        return T_base_tool @ inverse(self.T_flange_tool)
