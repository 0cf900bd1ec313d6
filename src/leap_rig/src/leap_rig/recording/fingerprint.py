"""Which robot a motion was recorded on: what must agree before the motion is replayed on one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from common.config import parse
from common.errors import ConfigError
from kuka_control.model.config import ControllerConfig, PtpConfig, RealTimeConfig, neighbours

MODEL = ("robot", "flange", "dh_parameters")
TOOL = ("tool_length", "tool_transform", "use_tool_transform", "tool_mass", "tool_center_of_mass", "marker_ring")
MOUNTING = ("mounting", "center_line")
LIMITS = (
    *("opening_angle", "z_lower_limit", "z_upper_limit", "inner_sphere_limit", "outer_sphere_limit"),
    *("joint_speed", "tcp_speed", "joint_acceleration", "joint_jerk", "velocity_ptp_slow", "velocity_ptp_fast"),
    *("velocity_ptp", "shaping", "collision_guard", "guard_margin", "guard_obstacles", "allow_contact"),
    "elbow_preference",
)
GROUPS = {"model": MODEL, "tool": TOOL, "mounting": MOUNTING, "limits": LIMITS}
FILES = ("dh_parameters", "guard_obstacles")  # compared by what is in them
NOTHING = "nothing"


def fingerprint(kuka: object, content: Callable[[str], str]) -> dict[str, dict[str, Any]]:
    """Returns values by group and key from the parameters under `kuka/`; empty groups if they describe no robot.
    `content` returns what stands for the content of a file, such as its hash."""
    config = controller_config(kuka)
    found: dict[str, dict[str, Any]] = {group: {} for group in GROUPS}
    if config is None:
        return found
    for group, keys in GROUPS.items():
        for key in keys:
            value = getattr(config, key, None)
            if value is not None:
                found[group][key] = content(value) if key in FILES and value else _plain(value)
    return found


def started_with(kuka: Mapping[str, Any]) -> tuple[object, Mapping[str, str]]:
    """Returns the parameters with which the controller started, whatever is set under `kuka/` since, and the hashes of
    its files then by their names; without a controller what is set, and none."""
    started = kuka.get("running")
    if not isinstance(started, Mapping):
        return kuka, {}
    values, files = started.get("parameters"), started.get("files") or {}
    return values, {str(values[key]): known for key, known in files.items()} if isinstance(values, Mapping) else {}


def differences(recorded: object, here: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Returns a line for each value that differs, and one if the recording or the parameters know no robot."""
    if not isinstance(recorded, Mapping) or not recorded.get("model"):
        return ["The recording does not say which robot it is of: no controller's parameters were set."]
    if not here.get("model"):
        return ["There are no valid parameters of a controller here."]
    lines = []
    for group in GROUPS:
        old, new = recorded.get(group), here.get(group, {})
        old = old if isinstance(old, Mapping) else {}
        for key in sorted({*old, *new}):
            a, b = old.get(key, NOTHING), new.get(key, NOTHING)
            if a != b:
                lines.append(f"{group}: {key} was {a} when it was recorded, and is {b} here.")
    return lines


def address(kuka: Mapping[str, Any]) -> str:
    """Returns where the robot's controller is by the parameters under `kuka/`: host and port."""
    return f"{kuka.get('ip', '')}:{kuka.get('port', '')}"


def moved_away(recorded: Mapping[str, Any], kuka: Mapping[str, Any]) -> str:
    """Returns a sentence if the recording is of a robot at another address, such as a simulated one; else ""."""
    there, here = recorded.get("address", NOTHING), address(kuka)
    if there == here:
        return ""
    return (
        f"It was recorded on the robot at {there}, and this one is at {here}: what stands around this arm may differ."
    )


def controller_config(kuka: object) -> ControllerConfig | None:
    """Returns the configuration that the parameters under `kuka/` describe; None if they are not valid."""
    if not isinstance(kuka, Mapping):
        return None
    for schema in (RealTimeConfig, PtpConfig):
        try:
            return parse(schema, kuka, "kuka/", others=neighbours(schema))
        except ConfigError:
            continue
    return None


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


KNOWN = frozenset(key for keys in GROUPS.values() for key in keys)
"""All keys of a fingerprint."""
LEFT_OUT = frozenset(field.name for schema in (RealTimeConfig, PtpConfig) for field in fields(schema)) - KNOWN
"""Parameters that change neither the arm, nor where it goes on a recorded path, nor how fast: address, rates, home, at
which torque a PTP motion ends, what answers on the robot and how long that waits.
"""
