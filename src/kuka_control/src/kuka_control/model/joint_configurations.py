"""Joint configurations by name or by seven angles, and whether the arm can take them; [deg] outside, [rad] inside."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import make_dataclass
from typing import Any

import numpy as np

from common.config import parse, vector
from common.errors import ConfigError
from common.poses import read_only
from iiwa_kinematics.robot_model import RobotModel

NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")


def named_configurations(values: object, model: RobotModel) -> dict[str, np.ndarray]:
    """Returns the joints [rad], shape (7,), of each name.

    Args:
        values: what the yaml holds: a mapping of names to seven angles [deg].
        model: the arm that they are for.

    Raises:
        ConfigError: with all faults.
    """
    if not isinstance(values, Mapping) or not values:
        raise ConfigError([f"The joint configurations are {values!r}, but must be a mapping of names to seven angles."])
    faults = [f"{name!r} is no name of a joint configuration." for name in values if not _is_name(name)]
    if faults:
        raise ConfigError(faults)
    schema = make_dataclass("JointConfigurations", [(name, np.ndarray, vector(7, "deg")) for name in values])
    read: Any = parse(schema, values)
    named = {name: read_only(np.radians(getattr(read, name))) for name in values}
    faults = [fault for name, q in named.items() for fault in range_faults(model, q, f"{name}: ")]
    if faults:
        raise ConfigError(faults)
    return named


def chosen_configuration(
    words: Sequence[str], named: Mapping[str, np.ndarray], model: RobotModel
) -> tuple[str, np.ndarray]:
    """Returns the chosen configuration, as a text and as joints [rad], shape (7,).

    Args:
        words: a name, or seven angles [deg].
        named: the configurations that have a name.
        model: the arm.

    Raises:
        ConfigError: it is neither, or out of the joints' ranges: every such joint is named.
    """
    if len(words) == 1 and words[0] in named:
        return words[0], named[words[0]]
    known = ", ".join(named)
    if len(words) == 1 and _is_name(words[0]):
        raise ConfigError([f"There is no joint configuration {words[0]!r}; known are {known}."])
    try:
        q = np.radians([float(word) for word in words])
    except ValueError:
        q = np.array([])
    if q.shape != (7,) or not np.all(np.isfinite(q)):
        raise ConfigError([f"'{' '.join(words)}' is neither one of {known} nor seven angles in deg."])
    faults = range_faults(model, q)
    if faults:
        raise ConfigError(faults)
    return "the given angles", read_only(q)


def range_faults(model: RobotModel, q: np.ndarray, prefix: str = "") -> list[str]:
    """Returns a sentence for each joint of q, shape (7,) [rad], that is out of its range."""
    low, high = np.degrees(model.lower), np.degrees(model.upper)
    return [
        f"{prefix}Joint {i + 1} at {angle:.6g} deg is out of its range of {low[i]:.6g} to {high[i]:.6g} deg."
        for i, angle in enumerate(np.degrees(q))
        if not model.lower[i] <= q[i] <= model.upper[i]
    ]


def _is_name(name: object) -> bool:
    return isinstance(name, str) and NAME.fullmatch(name) is not None
