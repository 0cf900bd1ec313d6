"""Holding the tool at a pose for a hand: what may be held, and the answers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from common import teleop_record
from common.poses import check_pose
from leap_kuka.numbers import MAX_HOLD_S, MAX_TILT_DEG, MAX_TOOL_DISTANCE_M

TOOL_AXIS = (0.0, 0.0, 1.0)  # of the tool, which points down


class HoldState(Enum):
    """Whether the tool is held."""

    NONE = teleop_record.NO_HOLD
    HELD = teleop_record.HELD  # for a hand
    TAKEN = teleop_record.TAKEN  # over by the hand that steers now
    LED = teleop_record.LED  # by a program
    KEPT = "kept"  # where a relative engagement stopped, for the next one


@dataclass(frozen=True)
class HoldAnswer:
    """The answer to a request: success, and one sentence about it."""

    success: bool
    sentence: str


@dataclass(frozen=True)
class Held:
    """A tool that stays."""

    T_base_tool: np.ndarray  # shape (4, 4) [m]
    until: float  # when that ends [s]


def hold_fault(T_base_tool: np.ndarray, duration: float, up: np.ndarray, axis: ArrayLike = TOOL_AXIS) -> str | None:
    """Returns why a pose, shape (4, 4) [m], cannot be held for `duration` [s], or None. `up` is the vertical in the
    base frame, and `axis` the one of the tool that points down at home, shape (3,) each."""
    if not 0.0 < duration <= MAX_HOLD_S:
        return f"the duration is {duration:g} s and must be above 0 and at most {MAX_HOLD_S:g} s"
    try:
        check_pose(T_base_tool)
    except ValueError as error:
        return str(error)
    distance = np.linalg.norm(T_base_tool[:3, 3])
    if distance > MAX_TOOL_DISTANCE_M:
        return f"the tool is {distance:.4g} m from the base; is it in metres?"
    tilt = math.degrees(math.acos(np.clip(-up @ T_base_tool[:3, :3] @ axis, -1.0, 1.0)))
    if tilt > MAX_TILT_DEG:
        must = "point down" if np.array_equal(axis, TOOL_AXIS) else "be tilted as at home"
        return f"the tool is tilted by {tilt:.1f} deg and must {must} within {MAX_TILT_DEG:g} deg"
    return None
