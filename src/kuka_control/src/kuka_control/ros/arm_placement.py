"""The parameter `arms`, in a controller's namespace or above it: where this arm stands beside others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rospy

from common.arms import arms_from
from common.config import parse
from common.errors import ConfigError
from common.frames import ArmFrames
from common.ros.calibration_use import check_use
from common.ros.params import wait_for_config
from common.ros.service_calls import ask_master, listens
from kuka_control.model.arms import placement_faults, walls
from kuka_control.model.config import ControllerConfig, neighbours
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.rig import workspace_of

NODES = ("kuka_real_time_node", "kuka_ptp_node")


class PlaceBesideOthers(NamedTuple):
    T_world_base: np.ndarray  # shape (4, 4) [m]
    walls: tuple[ConvexBody, ...]  # between it and the others, for the collision guard


def placed_beside_others(config: ControllerConfig, frames: ArmFrames, found: str, patience: float) -> PlaceBesideOthers:
    """Returns where this arm stands beside others, by the parameter `arms`, whose whole name is `found`. Of an arm
    whose controller runs counts what that started with. Waits for the others' parameters for `patience` [s] from the
    first on. Raises ConfigError: the arms may not move beside each other, or are not placed alike."""
    values = rospy.get_param(found)
    arms = arms_from(values, "arms/")
    again = "Calibrate the camera to both real arms, then run rosrun vision register_arms.py."
    check_use("The file of arms:=", arms.simulated, config.on_this_machine, again)
    own = frames.tf_prefix
    if own not in arms.placements:
        raise ConfigError([
            f"tf_prefix is {own!r}, but arms/ places only {', '.join(arms.placements)}; start this arm's controller "
            "in the namespace of one of them, with its name as tf_prefix, or delete the parameter arms."
        ])  # fmt: skip
    above = found[: -len("arms")]
    workspaces = {own: workspace_of(config)}
    for name in arms.placements.keys() - {own}:
        started = _started_with(f"{above}{name}/kuka")
        if started is None:
            other = wait_for_config(ControllerConfig, f"{above}{name}/kuka", neighbours(ControllerConfig), patience)
        elif started["arms"] == values:
            other = parse(ControllerConfig, started["parameters"], f"{name}/kuka/", neighbours(ControllerConfig))
        else:
            raise ConfigError([
                f"The controller of the arm {name} runs and was started with other values of arms/, so that both "
                "would not keep to the same wall between the arms; end it and start both."
            ])  # fmt: skip
        workspaces[name] = workspace_of(other)
    faults = placement_faults(arms, own, config.mounting, workspaces)
    if faults:
        raise ConfigError(faults)
    return PlaceBesideOthers(arms.placements[own].T_world_base, walls(arms, own))


def _started_with(namespace: str) -> dict | None:
    """Returns what a controller wrote under `namespace` at its start; None if it does not run any more."""
    started = rospy.get_param(f"{namespace}/running", None)
    if started is None:
        return None
    uris = [ask_master("lookupNode", f"{namespace.rpartition('/')[0]}/{node}") for node in NODES]
    return started if started["uri"] in uris and listens(started["uri"]) else None
