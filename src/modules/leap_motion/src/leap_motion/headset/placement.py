"""Where the virtual Leap stands in the headset's room, and the joints of a hand in its axes. Both have y up. The
room is a WebXR reference space [m], the Leap's joints are in millimetres. A heading is the angle [rad] about the
vertical from -z of the room to where the person looks, positive to the left."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

FROM_XR = np.array([[1, 1, 2, 3, 4], *([5 * i + j for j in range(5)] for i in range(1, 5))])
"""WebXR joint of the Leap's carp, mcp, pip, dip and btip (columns) of thumb to pinky (rows), shape (5, 5). The thumb of
the Leap has a metacarpal without length and counts one joint further out."""
REACH_M = 20.0  # farther from the origin nobody stands


@dataclass(frozen=True)
class Placement:
    """The virtual Leap in the room: its origin and heading; level with gravity."""

    origin: tuple[float, float, float]  # [m]
    heading: float  # [rad]

    def to_leap(self, points: np.ndarray) -> np.ndarray:
        """Returns points of the room, shape (n, 3) [m], in Leap axes [mm]."""
        cosine, sine = math.cos(self.heading), math.sin(self.heading)
        R_room_leap = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
        return 1e3 * (points - self.origin) @ R_room_leap


def placement(head: np.ndarray, ahead: float, below: float, height: float) -> Placement:
    """Returns the placement for which the middle of the box is `ahead` [m] of the head and `below` it [m]. `head` is
    its position [m] and its quaternion x, y, z, w, shape (7,); the box is `height` above the Leap [m]. Raises
    ValueError for a head that is not a pose, or that looks too far up or down to have a heading."""
    least_level = 0.5  # least horizontal part of the direction of sight: beyond 60 deg up or down it says no heading
    position, (x, y, z, w) = head[:3], head[3:]
    if not (np.isfinite(head).all() and abs(position).max() < REACH_M and abs(head[3:] @ head[3:] - 1.0) < 0.1):
        raise ValueError("The headset does not know where it is.")
    sight = np.array([-2.0 * (x * z + w * y), 0.0, 2.0 * (x * x + y * y) - 1.0])  # level part of the direction of sight
    level = math.hypot(sight[0], sight[2])
    if level < least_level:
        raise ValueError("Look straight ahead: then the box is placed before you.")
    middle = position + ahead / level * sight - [0.0, below + height, 0.0]
    return Placement(tuple(middle.tolist()), math.atan2(-sight[0], -sight[2]))


def xr_hand(numbers: object) -> np.ndarray | None:
    """Returns the positions of a WebXR hand, shape (25, 3) [m], from a list of 75 numbers; None for anything else."""
    xr_joints = 25  # of a WebXR hand: the wrist, four of the thumb, five of each finger, from the wrist outwards
    if not isinstance(numbers, list) or len(numbers) != 3 * xr_joints:
        return None
    if not all(type(number) in (int, float) and abs(number) < REACH_M for number in numbers):  # NaN is not below it
        return None
    return np.array(numbers, dtype=float).reshape(xr_joints, 3)
