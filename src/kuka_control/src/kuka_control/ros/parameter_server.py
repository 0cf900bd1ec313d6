"""Parameters and files for programs that may also run without a ROS master: asked for once, never waited for."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import rosgraph
import rospkg

from common import clock
from common.config import parse
from common.errors import ConfigError, RigError
from common.ros.calibration_use import check_use
from common.ros.files import file_hash, read_yaml
from common.ros.master import NoMaster, check_master, check_namespace
from common.ros.service_calls import listens
from iiwa_kinematics import robot_model
from kuka_control.model.config import ControllerConfig, DhDeviations
from kuka_control.model.obstacles import ConvexBody, obstacles_from


class NoParameters(RigError):
    """The parameter server has nothing under a name."""


def parameters(namespace: str) -> dict:
    """Returns what the parameter server has under `namespace`, as seen from this program's own (ROS_NAMESPACE or
    __ns:=); raises NoMaster or NoParameters."""
    master = master_of_this_graph()
    try:
        values = master.getParam(absolute(namespace))
    except rosgraph.MasterError:
        values = None
    except OSError as error:
        raise NoMaster(f"The ROS master does not answer: {error}.") from error
    if not isinstance(values, dict) or not values:
        raise NoParameters(f"The parameter server has no parameters under {namespace}/.")
    return values


def master_of_this_graph() -> rosgraph.Master:
    """Returns the master that ROS_MASTER_URI names if somebody listens there, else raises NoMaster."""
    check_namespace()
    check_master(0.0)
    return rosgraph.Master("/leap_rig_program")


def absolute(name: str) -> str:
    """Returns a name in the namespace of this program, which need not be a node."""
    return rosgraph.names.ns_join(rosgraph.names.get_ros_namespace(), name)


def living_node(name: str) -> bool:
    """Returns whether a node of this name, in this program's namespace, is registered and listens (a killed one does
    not); NoMaster: no master."""
    master = master_of_this_graph()
    try:
        return listens(master.lookupNode(absolute(name)))
    except (rosgraph.MasterError, OSError):
        return False


def shipped(name: str) -> Path:
    """Returns the path of a file in this package's folder config."""
    return Path(rospkg.RosPack().get_path("kuka_control")) / "config" / name


def running(config: ControllerConfig, arms: object, uri: str | None) -> dict:
    """Returns what a controller writes under kuka/running at its start, since what is set later does not count for
    it. These are its `parameters`, the hashes of its `files` by the parameters that name them, the parameter `arms`,
    its `uri`, and when it `started` [s]."""
    values = {field.name: getattr(config, field.name) for field in fields(config)}
    plain = {key: np.asarray(value).tolist() if not isinstance(value, str) else value for key, value in values.items()}
    files = {key: file_hash(plain[key]) for key in ("dh_parameters", "guard_obstacles") if plain[key]}
    return {"parameters": plain, "files": files, "arms": arms or "", "uri": uri or "", "started": clock.time()}


def guard_obstacles(config: ControllerConfig) -> tuple[ConvexBody, ...] | None:
    """Returns what the file of the collision guard's obstacles holds; None without one; RigError: not valid."""
    if not (config.collision_guard and config.guard_obstacles):
        return None
    path = Path(config.guard_obstacles)
    return obstacles_from(read_yaml(path), robot_model(config.robot, config.flange).wrist_flange, f"{path}: ")


def dh_deviations(config: ControllerConfig) -> DhDeviations | None:
    """Returns what the file of a calibrated arm holds; None if the parameter is empty; RigError: not plausible."""
    if not config.dh_parameters:
        return None
    path = Path(config.dh_parameters)
    found = parse(DhDeviations, read_yaml(path), f"{path}: ")
    again = "Measure the real arm, or leave dh_parameters empty."
    check_use(str(path), found.simulated, config.on_this_machine, again)
    if found.robot != config.robot:
        raise ConfigError([f"{path}: robot is {found.robot}, but the arm is a {config.robot}."])
    return found
