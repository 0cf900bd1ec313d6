"""Which robot a program speaks to: the few parameters of a controller that the simple controller needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from common.config import choice, integer, parse, text
from common.tool import ToolConfig
from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, ROBOTS
from kuka_control.model.config import ArmConfig, PtpConfig, RealTimeConfig, neighbours


@dataclass(frozen=True)
class RobotAddress(ToolConfig):
    """The arm, its tool, and where its controller listens."""

    robot: str = choice(*ROBOTS, doc="the arm")
    flange: str = choice(*FLANGE_HEIGHTS, doc="the media flange on the arm")
    ip: str = text(doc="address of the robot's controller")
    port: int = integer(low=1, high=65535, doc="TCP port of the toolbox server on the robot's controller")


OPTIONS = ("robot", "flange", "ip", "port", "tool_length")
"""What may be given beside the parameters, by its key."""


def robot_address(values: object, given: Mapping, prefix: str = "") -> RobotAddress:
    """Returns the robot that the parameters of a controller describe, changed by what was given beside them.

    Args:
        values: parameters of either controller; those that are no concern of an address are not looked at.
        given: stands above `values`; what is None is not given. A tool_length that is given is the whole tool.
        prefix: stands before each key in the messages, such as "kuka/".

    Raises:
        ConfigError: with all faults.
    """
    changes = {key: value for key, value in given.items() if value is not None}
    if "tool_length" in changes:
        changes["use_tool_transform"] = False
    merged: Any = {**values, **changes} if isinstance(values, Mapping) else values
    controllers = (ArmConfig, RealTimeConfig, PtpConfig)
    others = {field.name for schema in controllers for field in fields(schema)} | set(neighbours(ArmConfig))
    return parse(RobotAddress, merged, prefix, others=others - {field.name for field in fields(RobotAddress)})
