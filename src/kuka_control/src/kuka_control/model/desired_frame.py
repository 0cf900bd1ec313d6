"""A desired tool frame, and whether a pose can be one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import check_pose

MAX_DISTANCE_M = 5.0
"""A tool further from the base than this was not meant in metres [m]."""


@dataclass(frozen=True)
class DesiredFrame:
    """A desired tool frame."""

    T_base_tool: np.ndarray
    """Shape (4, 4) [m]."""
    stamp: float
    """ROS time [s]."""
    conflict: str | None = None
    """Why the controller must not follow it, a sentence, if that is known on arrival."""


def rejection_reason(T_base_tool: np.ndarray) -> str | None:
    """Returns why a matrix cannot be the pose of the tool in the base, the end of a sentence; None if it can."""
    try:
        T_base_tool = check_pose(T_base_tool)
    except ValueError as error:
        return f"{error}."
    distance = np.linalg.norm(T_base_tool[:3, 3])
    return f"it is {distance:.4g} m from the base; is it in metres?" if distance > MAX_DISTANCE_M else None
