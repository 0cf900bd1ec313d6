"""The measured tool, as far as it can be true: it moves as a tool can, and once was where it was sent.

A relative stream starts where it is at home, and a tool that stays is kept there, if the arm is far behind.
"""

from __future__ import annotations

import math
from typing import Callable

import numpy as np

from common.poses import check_pose

PERIOD_S = 0.05  # time between two looks while a stream runs
NEAR_M = 0.03  # from where it was sent
MAX_SPEED_M_S = 1.5  # of a tool; the shipped limit is less than half of it
AT_HOME_M = 0.03


Measured = Callable[[], np.ndarray]
"""Returns the measured T_base_tool, shape (4, 4) [m]; raises ValueError with what is wrong with it."""


def no_measured_tool() -> np.ndarray:
    """Raises ValueError: nobody measures the tool."""
    raise ValueError("the measured tool is unknown")


def tool_at_home(measured: Measured, centre: np.ndarray) -> np.ndarray:
    """Returns the tool of an arm that is at home, in the centre of the workspace, shape (3,) [m]; ValueError: it is
    unknown or elsewhere.
    """
    T_base_tool = measured()
    check_pose(T_base_tool)
    away = float(np.linalg.norm(T_base_tool[:3, 3] - centre))
    if away > AT_HOME_M:
        raise ValueError(f"it is measured {1e3 * away:.0f} mm from home, where the arm is said to be")
    return T_base_tool


class TrueTool:
    """What a `measured` returns, T_base_tool with shape (4, 4) [m], if it can be true; `newest` is None otherwise.

    It counts when it is near the tool that was sent, and then for as long as it moves no faster than a tool can.
    """

    def __init__(self) -> None:
        self._at = -math.inf
        self.newest: np.ndarray | None = None

    def look(self, measured: Measured, T_base_sent: np.ndarray | None, now: float) -> np.ndarray | None:
        """Updates `newest`, and returns it, at `now` [s]; `T_base_sent`: where the tool was sent, or None."""
        elapsed = now - self._at
        if T_base_sent is not None and elapsed < PERIOD_S:
            return self.newest
        self._at, before = now, self.newest
        self.newest = None
        try:
            T_base_tool = measured()
            check_pose(T_base_tool)
        except ValueError:
            return None
        sent = T_base_sent is not None and _apart(T_base_tool, T_base_sent) <= NEAR_M
        if sent or (before is not None and _apart(T_base_tool, before) <= NEAR_M + MAX_SPEED_M_S * elapsed):
            self.newest = T_base_tool
        return self.newest


def _apart(T: np.ndarray, T_other: np.ndarray) -> float:
    return float(np.linalg.norm((T - T_other)[:3, 3]))
