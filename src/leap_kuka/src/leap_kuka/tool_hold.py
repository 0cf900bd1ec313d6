"""A pose at which the tool waits for a hand, and how that hand takes the tool over from there without a jump.

The hand that comes in stands somewhere in the interaction box, level within the start tolerances. The virtual Leap is
shifted and turned about the vertical such that palm and heading of the hand are those of the tool that is held. What is
left, the tilt of the hand at its start, fades in: the tool begins exactly as it was held, and FADE_S later a level hand
means a tool that points down, as ever.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.poses import check_pose, pose, read_only
from common.rotations import rotation_about, scaled_rotation

NONE, HELD, TAKEN = "none", "held", "taken"
"""No hold; the tool is held for a hand; a hand has taken it over."""

MAX_DURATION_S = 120.0
MAX_DISTANCE_M = 5.0
"""A tool further from the base than this was not meant in metres [m]."""

MAX_TILT_DEG = 10.0
"""A hold starts a stream with the tool pointing down, so it has to point down within this [deg]."""

FADE_S = 1.0
"""The tilt of the hand at its start gets its full effect in this time [s]."""


@dataclass(frozen=True)
class Answer:
    """Whether a request was carried out, and one sentence about it."""

    success: bool
    sentence: str


class ToolHold:
    """The pose that is held, and why no longer.

    Args:
        up: the world's vertical in the base frame, shape (3,).

    Attributes:
        T_base_tool: the pose that is held, shape (4, 4) [m]; None if none is.
    """

    def __init__(self, up: np.ndarray) -> None:
        self._up = up
        self._control_on = False
        self._until = 0.0
        self._ended: str | None = None
        self.T_base_tool: np.ndarray | None = None

    def ask(self, T_base_tool: np.ndarray, duration: float, now: float, hindrance: str | None) -> Answer:
        """Begins to hold a pose.

        Args:
            T_base_tool: shape (4, 4) [m].
            duration: how long it is held without a hand [s].
            now: on any clock that never jumps [s].
            hindrance: why the stream allows no hold, or None.
        """
        fault = hold_fault(T_base_tool, duration, self._up) or hindrance
        if fault is None and self.T_base_tool is not None:
            fault = "it is held already; end that hold first, by a duration of 0"
        if fault is None and not self._control_on:
            fault = "control of the arm is off"
        if fault:
            return Answer(False, f"The tool is not held: {fault}.")
        self.T_base_tool, self._until, self._ended = read_only(T_base_tool), now + duration, None
        return Answer(True, f"The tool is held for a hand, for {duration:g} s at most.")

    def control(self, on: bool) -> None:
        """Tells whether control of the arm is on; a hold ends with it."""
        self._control_on = on
        if not on:
            self.end("control of the arm is off")

    def expire(self, now: float) -> None:
        """Ends the hold when its time is over."""
        if now >= self._until:
            self.end("no hand took it over in time")

    def end(self, why: str) -> None:
        """Ends the hold if there is one."""
        if self.T_base_tool is not None:
            self.T_base_tool, self._ended = None, f"the tool is held no longer: {why}"

    def take(self) -> np.ndarray | None:
        """Ends the hold because a hand takes the tool over; returns the pose, if there was one."""
        T_base_tool, self.T_base_tool = self.T_base_tool, None
        return T_base_tool

    def news(self) -> str | None:
        """Returns once why the hold ended."""
        ended, self._ended = self._ended, None
        return ended


def hold_fault(T_base_tool: np.ndarray, duration: float, up: np.ndarray) -> str | None:
    """Returns why a pose cannot be held, the end of a sentence, or None.

    Args:
        T_base_tool: shape (4, 4) [m].
        duration: for so long [s].
        up: the world's vertical in the base frame, shape (3,).
    """
    if not 0.0 < duration <= MAX_DURATION_S:
        return f"the duration is {duration:g} s and must be above 0 and at most {MAX_DURATION_S:g} s"
    try:
        check_pose(T_base_tool)
    except ValueError as error:
        return str(error)
    distance = np.linalg.norm(T_base_tool[:3, 3])
    if distance > MAX_DISTANCE_M:
        return f"the tool is {distance:.4g} m from the base; is it in metres?"
    tilt = math.degrees(math.acos(np.clip(-up @ T_base_tool[:3, 2], -1.0, 1.0)))
    if tilt > MAX_TILT_DEG:
        return f"the tool is tilted by {tilt:.1f} deg and must point down within {MAX_TILT_DEG:g} deg"
    return None


@dataclass(frozen=True)
class HandOver:
    """How the tool of a stream differs from that of a hand that came in without a hold.

    Attributes:
        T_base_virtual: the virtual Leap, shape (4, 4) [m].
        R_rest: what the tool is turned by at the start, besides what the hand asks for; it fades; shape (3, 3).
        start: when the stream started [s].
    """

    T_base_virtual: np.ndarray
    R_rest: np.ndarray
    start: float

    def rotation(self, R_virtual_tool: np.ndarray, now: float) -> np.ndarray:
        """Returns the attitude of the tool, shape (3, 3), where the hand alone would ask for the given one."""
        s = min(max((now - self.start) / FADE_S, 0.0), 1.0)
        share = 1.0 - s * s * (3.0 - 2.0 * s)
        return R_virtual_tool @ scaled_rotation(self.R_rest, share)


def hand_over(
    T_base_held: np.ndarray,
    T_base_virtual: np.ndarray,
    T_virtual_tool: np.ndarray,
    R_virtual_level: np.ndarray,
    now: float,
) -> HandOver:
    """Returns how a hand takes the tool over.

    Args:
        T_base_held: where the tool was held, shape (4, 4) [m].
        T_base_virtual: the virtual Leap as it would be without a hold, shape (4, 4) [m].
        T_virtual_tool: the tool that the hand asks for at its start, shape (4, 4) [m].
        R_virtual_level: the tool's attitude for a level hand of the same heading, shape (3, 3).
        now: start of the stream [s].
    """
    R_base_level, R_base_held = T_base_virtual[:3, :3] @ R_virtual_level, T_base_held[:3, :3]
    R_level_held = R_base_level.T @ R_base_held
    heading = rotation_about(2, math.atan2(R_level_held[1, 0], R_level_held[0, 0]))
    R_base_virtual = R_base_level @ heading @ R_virtual_level.T
    p = T_base_held[:3, 3] - R_base_virtual @ T_virtual_tool[:3, 3]
    R_rest = (R_base_virtual @ T_virtual_tool[:3, :3]).T @ R_base_held
    return HandOver(read_only(pose(R_base_virtual, p)), read_only(R_rest), now)
