"""Where a tool stays that an engagement leaves while the arm is behind it: no motion may follow that the hand did
not ask for. The measured tool is believed only near the desired one; positions are where the controller's scaling
brings them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Callable

import numpy as np

from common.poses import check_pose, pose
from leap_kuka.numbers import AT_HOME_M, BEHIND_M, GLIDE_M_S, JUST_S, LOOK_PERIOD_S, MOVED_M, STOP_M

Measured = Callable[[], np.ndarray]
"""Returns the measured T_base_tool, shape (4, 4) [m]; raises ValueError with what is wrong with it."""


def no_measured_tool() -> np.ndarray:
    """Raises ValueError: nobody measures the tool."""
    raise ValueError("the measured tool is unknown")


def tool_at_home(measured: Measured, centre: np.ndarray) -> np.ndarray:
    """Returns the tool of an arm that is at home, in the centre of the workspace, shape (3,) [m]; ValueError: it is
    unknown or elsewhere."""
    T_base_tool = measured()
    check_pose(T_base_tool)
    away = float(np.linalg.norm(T_base_tool[:3, 3] - centre))
    if away > AT_HOME_M:
        raise ValueError(f"it is measured {1e3 * away:.0f} mm from home, where the arm is said to be")
    return T_base_tool


@dataclass(frozen=True)
class Leaving:
    """A tool that was left at `start` [s]: poses of shape (4, 4) [m]."""

    T_sent: np.ndarray  # where it was sent last
    start: float
    T_measured: np.ndarray | None = None  # of an arm that is behind and follows, or brakes
    brakes: bool = False


class ToolBehind:
    """Follows the measured tool of an arm while a stream runs, and says where the tool stays afterwards."""

    def __init__(self) -> None:
        self._looked_at = -math.inf
        self._near: tuple[float, np.ndarray] | None = None  # when the arm was last near, and where

    def look(self, measured: Measured, T_sent: np.ndarray, now: float) -> None:
        """Looks where the arm is, at `now` [s], while the tool is sent to a pose."""
        if now - self._looked_at < LOOK_PERIOD_S:
            return
        self._looked_at, T_measured = now, _pose(measured)
        if T_measured is not None and _apart(T_measured, T_sent) <= BEHIND_M:
            self._near = now, T_measured

    def leave(self, measured: Measured, T_sent: np.ndarray, now: float) -> Leaving:
        """Returns how the tool is left `now` [s]."""
        T_measured = _pose(measured)
        if T_measured is None or _apart(T_measured, T_sent) <= STOP_M:
            return Leaving(T_sent, now)
        if _apart(T_measured, T_sent) <= BEHIND_M:
            return Leaving(T_sent, now, T_measured)
        at, T_near = self._near or (-math.inf, T_measured)
        if now - at <= JUST_S and _apart(T_measured, T_near) <= MOVED_M:
            return Leaving(T_sent, now, T_measured, brakes=True)
        return Leaving(T_sent, now)


def kept(left: Leaving, measured: Measured, now: float) -> np.ndarray | None:
    """Returns where the tool that was left stays at `now` [s], shape (4, 4) [m]; None: where it is. It glides to
    where an arm that follows can stop, or goes with an arm that brakes, which finds it there at its rest."""
    if left.T_measured is None:
        return None
    if left.brakes:
        T_measured = _pose(measured) if now - left.start <= JUST_S else None
        near = T_measured is not None and _apart(T_measured, left.T_measured) <= MOVED_M
        return T_measured if near else None
    way = left.T_measured[:3, 3] - left.T_sent[:3, 3]
    length = float(np.linalg.norm(way))
    s = min(GLIDE_M_S * (now - left.start), length - STOP_M)
    return pose(left.T_sent[:3, :3], left.T_sent[:3, 3] + s / length * way)


def _pose(measured: Measured) -> np.ndarray | None:
    try:
        T_base_tool = measured()
        check_pose(T_base_tool)
    except ValueError:
        return None
    return T_base_tool


def _apart(T: np.ndarray, T_other: np.ndarray) -> float:
    return float(np.linalg.norm((T - T_other)[:3, 3]))
