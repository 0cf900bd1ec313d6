"""The address of the robot, from the parameters of a controller and the options of the simple controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from common.config import parse
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig, RobotAddress, neighbours

OPTIONS = ("robot", "flange", "ip", "port", "tool_length")
"""Keys that may be given as options too."""


def robot_address(values: object, given: Mapping, prefix: str = "") -> RobotAddress:
    """Returns the robot that the parameters of a controller describe, overridden by options.

    Args:
        values: parameters of either controller; keys that do not belong to an address are ignored.
        given: options by their keys, which override `values`; None: not given. A given tool_length is the whole tool.
        prefix: stands before each key in the messages, such as "kuka/".

    Raises:
        ConfigError: with all faults.
    """
    changes = {key: value for key, value in given.items() if value is not None}
    if "tool_length" in changes:
        changes["use_tool_transform"] = False
    merged: Any = {**values, **changes} if isinstance(values, Mapping) else values
    controllers = (ControllerConfig, RealTimeConfig, PtpConfig)
    others = {field.name for schema in controllers for field in fields(schema)} | set(neighbours(ControllerConfig))
    return parse(RobotAddress, merged, prefix, others=others - {field.name for field in fields(RobotAddress)})
