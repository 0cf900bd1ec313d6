"""Arms that stand in one world: the yaml with the place of each, which controllers and simulation read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from common.config import is_number, parse_part, vector
from common.errors import ConfigError
from common.frames import PREFIX
from common.mounting import rotation_of_mounting
from common.poses import pose, read_only
from common.simulated import SIMULATED, MeasuredWith


@dataclass(frozen=True)
class BasePlacement:
    """Where the base of an arm stands in the frame `world`."""

    position: np.ndarray = vector(3, "m", low=-10.0, high=10.0, doc="x, y, z of the arm's base in world")
    rpy: np.ndarray = vector(
        3, "deg", low=-180.0, high=180.0, doc="roll, pitch, yaw of the arm's base in world", absent=[0.0, 0.0, 0.0]
    )

    @cached_property
    def T_world_base(self) -> np.ndarray:
        """Pose of the base in world, shape (4, 4) [m]."""
        return read_only(pose(rotation_of_mounting(self.rpy), self.position))


@dataclass(frozen=True)
class Arms:
    """Two arms or more by their names, which are also their namespaces and the prefixes of their frames."""

    margin: float  # between tool points of different arms [m]
    placements: Mapping[str, BasePlacement]
    simulated: bool | None = None  # whether they were measured with simulated devices; None: they do not say


def arms_from(values: Any, prefix: str = "") -> Arms:
    """Returns what a yaml mapping of `margin` and the arms' names describes; raises ConfigError with all faults.
    `prefix`, such as "arms/", stands before each key in messages."""
    least_margin_m = 0.3  # both hands, and what the elbows stick out beyond the tools [m]
    most_margin_m = 5.0
    if not isinstance(values, Mapping):
        raise ConfigError(
            [f"{prefix or 'The file '}is {values!r}, but must be a mapping: margin, and each arm's name."]
        )
    faults: list[str] = []
    margin: Any = values.get("margin")
    if not is_number(margin) or not least_margin_m <= margin <= most_margin_m:
        limits = f"[{least_margin_m:g}, {most_margin_m:g}]"
        faults.append(f"{prefix}margin is {margin!r}, but must be a finite number in {limits} m.")
    placements = {}
    for name, entry in values.items():
        if name == "margin":
            continue
        if name == SIMULATED:
            parse_part(MeasuredWith, {name: entry}, prefix, faults)
            continue
        if not isinstance(name, str) or not name or not PREFIX.fullmatch(name):
            faults.append(f"{prefix}{name}: an arm's name must be letters, digits and _, such as left.")
            continue
        placement = parse_part(BasePlacement, entry, f"{prefix}{name}/", faults)
        if placement is not None:
            placements[name] = placement
    if not faults and len(placements) < 2:
        faults.append(f"{prefix or 'The file '}names {len(placements)} arms, but must name at least two.")
    if faults:
        raise ConfigError(faults)
    return Arms(float(margin), placements, values.get(SIMULATED))
