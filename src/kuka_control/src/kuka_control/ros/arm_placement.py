"""The parameter `arms`, in a controller's namespace or above it: where this arm stands beside others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rospy

from common.arms import arms_from
from common.errors import ConfigError
from common.frames import ArmFrames
from common.ros.params import wait_for_config
from kuka_control.model.arms import placement_faults, walls
from kuka_control.model.config import ControllerConfig, neighbours
from kuka_control.model.obstacles import ConvexBody
from kuka_control.model.rig import workspace_of


class PlaceBesideOthers(NamedTuple):
    """Where an arm stands."""

    T_world_base: np.ndarray  # shape (4, 4) [m]
    walls: tuple[ConvexBody, ...]  # between it and the others, for the collision guard


def placed_beside_others(config: ControllerConfig, frames: ArmFrames, patience: float) -> PlaceBesideOthers | None:
    """Returns where this arm stands beside others; None for an only arm, without the parameter `arms`.

    Waits for the parameters of the others, from the first of an arm on for `patience` [s].

    Raises:
        ConfigError: the arms may not move beside each other.
    """
    found = rospy.search_param("arms")
    if found is None:
        return None
    arms = arms_from(rospy.get_param(found), "arms/")
    own = frames.tf_prefix
    if own not in arms.placements:
        raise ConfigError([
            f"tf_prefix is {own!r}, but arms/ places only {', '.join(arms.placements)}; start this arm's controller "
            "in the namespace of one of them, with its name as tf_prefix, or delete the parameter arms."
        ])  # fmt: skip
    above = found[: -len("arms")]
    workspaces = {own: workspace_of(config)}
    for name in arms.placements.keys() - {own}:
        other = wait_for_config(ControllerConfig, f"{above}{name}/kuka", neighbours(ControllerConfig), patience)
        workspaces[name] = workspace_of(other)
    faults = placement_faults(arms, own, config.mounting, workspaces)
    if faults:
        raise ConfigError(faults)
    return PlaceBesideOthers(arms.placements[own].T_world_base, walls(arms, own))
