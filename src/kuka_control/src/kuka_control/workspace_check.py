"""Everything that is wrong with a set of parameters for the arm, in one go."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from common.config import parse
from common.errors import ConfigError
from kuka_control.assembly import Rig
from kuka_control.config import ArmConfig, neighbours
from kuka_control.home_pose import HomeError
from kuka_control.kinematics import DhDeviations
from kuka_control.robot_model import robot_model
from kuka_control.workspace import workspace_faults


def checked_rig(
    values: Mapping, prefix: str = "", read_dh: Callable[[ArmConfig], DhDeviations | None] = lambda config: None
) -> tuple[ArmConfig, Rig]:
    """Returns the parameters and the arm with workspace and home that they describe.

    Unlike a controller, which stops at the first kind of fault, this also looks at the geometry of a workspace of which
    single values are out of range.

    Args:
        values: what the yaml or the parameter server holds, of either controller.
        prefix: stands before each key in the messages, such as "kuka/".
        read_dh: reads the file that the parameter dh_parameters names.

    Raises:
        ConfigError: with all faults, one sentence each.
    """
    try:
        config = parse(ArmConfig, values, prefix, others=neighbours(ArmConfig))
    except ConfigError as error:
        raise ConfigError([*error.faults, *_further_faults(values, prefix, error.faults)]) from error
    try:
        return config, Rig.of(config, read_dh(config))
    except HomeError as error:
        raise ConfigError([str(error)]) from error


def _further_faults(values: Mapping, prefix: str, known: tuple[str, ...]) -> list[str]:
    """Returns faults of the workspace as a whole, without those of keys that `known` has a sentence about."""
    limits = ("z_lower_limit", "z_upper_limit", "inner_sphere_limit", "outer_sphere_limit")
    try:
        height = robot_model(values["robot"], values["flange"]).base_shoulder
        angle = math.radians(values["opening_angle"])
        z_lower, z_upper, inner, outer = (float(values[key]) for key in limits)
        line = np.array(values["center_line"], dtype=float)
    except (KeyError, TypeError, ValueError):
        return []  # without all the numbers there is no geometry to judge
    if line.shape != (3,) or not np.all(np.isfinite([*line, angle, z_lower, z_upper, inner, outer])):
        return []
    found = workspace_faults(line, angle, z_lower, z_upper, inner, outer, height)
    named = {fault[len(prefix) :].split()[0] for fault in known}
    return [f"{prefix}{fault}" for fault in found if fault.split()[0] not in named]
