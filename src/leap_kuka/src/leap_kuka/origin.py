"""What a stream starts from: which pose of the tool belongs to which pose of the hand. Absolute: the hand's angles
count from a level hand of the stream's heading; a held tool that is taken over shifts and turns the virtual Leap so
that palm and heading match; the tool keeps its tilt, and the hand's tilt takes effect in FADE_S. Relative: they count
from the hand's orientation at the start, and the virtual Leap is shifted such that the palm is at the tool."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from common.poses import pose, read_only
from common.rotations import rotation_about, rotation_from_zyx, scaled_rotation
from leap_kuka.numbers import FADE_S
from leap_kuka.virtual_leap import R_LEAP_REFERENCE, TURNED, Attitude

I3 = read_only(np.eye(3))


@dataclass(frozen=True)
class FadingStep:
    """What is between a tool and where it shall be: it fades out in FADE_S."""

    p: np.ndarray  # shape (3,) [m]
    R: np.ndarray  # in the axes of the wanted tool, shape (3, 3)
    start: float  # [s]

    def added(self, T: np.ndarray, now: float) -> np.ndarray:
        """Returns a wanted pose, shape (4, 4) [m], with what is left of the step."""
        left = _left(now - self.start)
        return pose(T[:3, :3] @ scaled_rotation(self.R, left), T[:3, 3] + left * self.p)


@dataclass(frozen=True)
class StreamOrigin:
    """What a stream starts from; rotations have shape (3, 3)."""

    T_base_virtual: np.ndarray  # pose of the virtual Leap, shape (4, 4) [m]
    R_leap_zero: np.ndarray  # orientation of a hand whose angles are zero
    R_zero_tool: np.ndarray  # of the tool for that hand, in the axes of the hand
    R_home: np.ndarray  # of the tool at home relative to one that points down
    R_rest: np.ndarray | None = None  # additional rotation of the tool at the start; it fades out
    R_tilt: np.ndarray = field(default_factory=lambda: I3)  # of a tool that was taken over; it stays
    start: float = 0.0  # of the stream [s]

    def turn(self, R_leap_hand: np.ndarray) -> np.ndarray:
        """Returns the orientation whose attitude at heading 0 is that of the hand from the origin."""
        return R_LEAP_REFERENCE @ self.R_leap_zero.T @ R_leap_hand

    def rotation(self, angles: Attitude, now: float) -> np.ndarray:
        """Returns R_virtual_tool for the hand's angles from the origin, at `now` [s]."""
        R_virtual_tool = self.R_leap_zero @ rotation_from_zyx(*angles.angles) @ self.R_zero_tool
        if self.R_rest is not None:
            R_virtual_tool = R_virtual_tool @ scaled_rotation(self.R_rest, _left(now - self.start))
        return R_virtual_tool @ self.R_tilt @ self.R_home


def absolute(T_base_virtual: np.ndarray, heading: float, tool_reversed: bool, R_home: np.ndarray = I3) -> StreamOrigin:
    """Returns the origin of an absolute stream of a heading [rad], see virtual_leap_pose for T_base_virtual; a tool
    that is `tool_reversed` is turned by 180 deg about its z axis, as the home pose has it (see common.mounting)."""
    R_leap_zero = R_LEAP_REFERENCE @ rotation_about(2, heading)
    return StreamOrigin(T_base_virtual, R_leap_zero, TURNED if tool_reversed else I3, R_home)


def taken_over(
    origin: StreamOrigin, T_base_held: np.ndarray, angles: Attitude, palm: np.ndarray, now: float
) -> StreamOrigin:
    """Returns the origin of an absolute stream that starts `now` [s] with the tool where it is held, shape (4, 4)
    [m]. `origin` is that of the same stream without a hold, `angles` are the hand's at its start, and `palm` has
    shape (3,)."""
    R_base_held = T_base_held[:3, :3] @ origin.R_home.T
    R_virtual_level = origin.R_leap_zero @ origin.R_zero_tool
    R_base_level = origin.T_base_virtual[:3, :3] @ R_virtual_level
    R_level_held = R_base_level.T @ R_base_held
    heading = rotation_about(2, math.atan2(R_level_held[1, 0], R_level_held[0, 0]))
    R_base_virtual = R_base_level @ heading @ R_virtual_level.T
    R_tilt = heading.T @ R_level_held
    R_virtual_tool = origin.R_leap_zero @ rotation_from_zyx(*angles.angles) @ origin.R_zero_tool
    return replace(
        origin,
        T_base_virtual=read_only(pose(R_base_virtual, T_base_held[:3, 3] - R_base_virtual @ palm)),
        R_rest=read_only((R_base_virtual @ R_virtual_tool).T @ R_base_held @ R_tilt.T),
        R_tilt=read_only(R_tilt),
        start=now,
    )


def relative(T_base_tool: np.ndarray, R_base_virtual: np.ndarray, T_leap_hand: np.ndarray) -> StreamOrigin:
    """Returns the origin of a stream that starts with the desired tool at a pose and the hand at another, shapes (4,
    4) [m], and an orientation of the virtual Leap, shape (3, 3)."""
    R_leap_hand = T_leap_hand[:3, :3]
    T_base_virtual = pose(R_base_virtual, T_base_tool[:3, 3] - R_base_virtual @ T_leap_hand[:3, 3])
    R_virtual_tool = R_base_virtual.T @ T_base_tool[:3, :3]
    return StreamOrigin(read_only(T_base_virtual), R_leap_hand, read_only(R_leap_hand.T @ R_virtual_tool), I3)


def _left(elapsed: float) -> float:
    """Returns what is left, 1 to 0, of something that fades out, so long after its start [s]."""
    s = min(max(elapsed / FADE_S, 0.0), 1.0)
    return 1.0 - s * s * (3.0 - 2.0 * s)
