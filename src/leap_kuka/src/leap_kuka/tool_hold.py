"""Holding the tool at a pose for a hand, and the hand-over to that hand without a jump.

The hand that comes in is in the interaction box, level within the start tolerances. The virtual Leap is shifted and
turned about the vertical such that palm and heading of the hand match the held tool. The remaining rotation, the tilt
of the hand at its start, fades out: the stream starts with the tool as it was held, and FADE_S later a level hand means
a tool that points down, as in any stream.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from common.poses import check_pose, pose, read_only
from common.rotations import rotation_about, scaled_rotation

MAX_DURATION_S = 120.0
MAX_DISTANCE_M = 5.0  # a larger distance from the base is probably not in metres [m]
MAX_TILT_DEG = 10.0  # a stream starts with the tool as at home, pointing down, so a held tool does within this [deg]
TOOL_AXIS = (0.0, 0.0, 1.0)  # of the tool, which points down
FADE_S = 1.0  # time in which the tilt of the hand at its start takes full effect [s]


class HoldState(Enum):
    """Whether the tool is held."""

    NONE = "none"
    HELD = "held"  # for a hand
    TAKEN = "taken"  # over by the hand that steers now
    KEPT = "kept"  # where a relative engagement stopped, for the next one


@dataclass(frozen=True)
class HoldAnswer:
    """The answer to a request: success, and one sentence about it."""

    success: bool
    sentence: str


@dataclass(frozen=True)
class Held:
    """A hold."""

    T_base_tool: np.ndarray  # shape (4, 4) [m]
    until: float  # when it ends [s]
    kept: bool  # where an engagement stopped, not on request


class ToolHold:
    """The hold `held`, or None.

    `up` is the vertical in the base frame, and `axis` the one of the tool that points down at home, shape (3,) each.
    """

    def __init__(self, up: np.ndarray, axis: ArrayLike = TOOL_AXIS) -> None:
        self._up, self._axis = up, np.asarray(axis)
        self._control_on = False
        self._ended: str | None = None
        self.held: Held | None = None

    @property
    def T_base_tool(self) -> np.ndarray | None:
        """The held pose, shape (4, 4) [m], or None."""
        return None if self.held is None else self.held.T_base_tool

    @property
    def kept(self) -> bool:
        """Whether the tool is kept where an engagement stopped."""
        return self.held is not None and self.held.kept

    def start(self, T_base_tool: np.ndarray, duration: float, now: float, inhibit_reason: str | None) -> HoldAnswer:
        """Holds a pose, shape (4, 4) [m], for at most `duration` [s], unless it is invalid or inhibited."""
        fault = hold_fault(T_base_tool, duration, self._up, self._axis) or inhibit_reason
        if fault is None and self.held is not None:
            fault = "it is held already" + ("" if self.kept else "; end that hold first with a duration of 0")
        if fault is None and not self._control_on:
            fault = "control of the arm is off"
        if fault:
            return HoldAnswer(False, f"The tool is not held: {fault}.")
        self.held, self._ended = Held(read_only(T_base_tool), now + duration, False), None
        return HoldAnswer(True, f"The tool is held for a hand, for {duration:g} s at most.")

    def keep(self, T_base_tool: np.ndarray, duration: float, now: float) -> None:
        """Keeps the tool where an engagement stopped, shape (4, 4) [m], for at most `duration` [s], while control is
        on.
        """
        if self._control_on:
            self.held, self._ended = Held(read_only(T_base_tool), now + duration, True), None

    def renew(self, duration: float, now: float) -> None:
        """Lets the hold last `duration` [s] from `now` on."""
        if self.held is not None:
            self.held = replace(self.held, until=now + duration)

    def left(self, now: float) -> float:
        """Returns the time until the hold ends [s], 0 without one."""
        return 0.0 if self.held is None else max(self.held.until - now, 0.0)

    def control(self, on: bool) -> None:
        """Sets whether control of the arm is on; switching it off ends the hold."""
        self._control_on = on
        if not on:
            self.end("control of the arm is off")

    def expire(self, now: float) -> None:
        """Ends the hold when its time is over."""
        if self.held is not None and now >= self.held.until:
            self.end("no hand took it over in time")

    def end(self, why: str) -> None:
        """Ends the hold if there is one."""
        if self.held is not None:
            self.held, self._ended = None, f"the tool is no longer held: {why}"

    def take(self) -> np.ndarray | None:
        """Ends the hold because a hand takes the tool over; returns the pose, if there was one."""
        T_base_tool, self.held = self.T_base_tool, None
        return T_base_tool

    def end_reason(self) -> str | None:
        """Returns, once, why the hold ended."""
        ended, self._ended = self._ended, None
        return ended


def hold_fault(T_base_tool: np.ndarray, duration: float, up: np.ndarray, axis: ArrayLike = TOOL_AXIS) -> str | None:
    """Returns why a pose, shape (4, 4) [m], cannot be held for `duration` [s], or None; the others as in ToolHold."""
    if not 0.0 < duration <= MAX_DURATION_S:
        return f"the duration is {duration:g} s and must be above 0 and at most {MAX_DURATION_S:g} s"
    try:
        check_pose(T_base_tool)
    except ValueError as error:
        return str(error)
    distance = np.linalg.norm(T_base_tool[:3, 3])
    if distance > MAX_DISTANCE_M:
        return f"the tool is {distance:.4g} m from the base; is it in metres?"
    tilt = math.degrees(math.acos(np.clip(-up @ T_base_tool[:3, :3] @ axis, -1.0, 1.0)))
    if tilt > MAX_TILT_DEG:
        must = "point down" if np.array_equal(axis, TOOL_AXIS) else "be tilted as at home"
        return f"the tool is tilted by {tilt:.1f} deg and must {must} within {MAX_TILT_DEG:g} deg"
    return None


@dataclass(frozen=True)
class HandOver:
    """The difference between a stream that took over a held tool and any other stream."""

    T_base_virtual: np.ndarray  # pose of the virtual Leap, shape (4, 4) [m]
    R_rest: np.ndarray  # additional rotation of the tool at the start, shape (3, 3); it fades out
    start: float  # start of the stream [s]

    def rotation(self, R_virtual_tool: np.ndarray, now: float) -> np.ndarray:
        """Returns the orientation of the tool, shape (3, 3), from the one that the hand alone asks for."""
        s = min(max((now - self.start) / FADE_S, 0.0), 1.0)
        return R_virtual_tool @ scaled_rotation(self.R_rest, 1.0 - s * s * (3.0 - 2.0 * s))


def hand_over(
    T_base_held: np.ndarray,
    T_base_virtual: np.ndarray,
    T_virtual_tool: np.ndarray,
    R_virtual_level: np.ndarray,
    now: float,
) -> HandOver:
    """Returns the hand-over of a held tool to a hand whose stream starts `now` [s].

    `T_base_virtual` is the virtual Leap's pose without a hold, `T_virtual_tool` the pose that the hand asks for at its
    start, shape (4, 4) [m], and `R_virtual_level` the tool's orientation for a level hand of that heading.
    """
    R_base_level, R_base_held = T_base_virtual[:3, :3] @ R_virtual_level, T_base_held[:3, :3]
    R_level_held = R_base_level.T @ R_base_held
    heading = rotation_about(2, math.atan2(R_level_held[1, 0], R_level_held[0, 0]))
    R_base_virtual = R_base_level @ heading @ R_virtual_level.T
    p = T_base_held[:3, 3] - R_base_virtual @ T_virtual_tool[:3, 3]
    R_rest = (R_base_virtual @ T_virtual_tool[:3, :3]).T @ R_base_held
    return HandOver(read_only(pose(R_base_virtual, p)), read_only(R_rest), now)
