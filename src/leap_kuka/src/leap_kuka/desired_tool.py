"""The desired orientation of the tool: the attitude of the hand, with each angle clipped.

The reference hand lies flat and points away from the user: x = -z_leap, z = -y_leap (down), hence y = x_leap (right).
The attitude of a hand is R_reference_hand = Rz(yaw) Ry(pitch) Rx(roll): positive yaw points right, positive pitch up
and positive roll lowers the right side. (The tracker's own roll has the opposite sign.)

Yaw is relative to the heading of the hand at the start of the stream, not to the Leap's -z axis, so that a hand that
comes in at a large yaw does not start clipped. Pitch and roll do not depend on the heading.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.rotations import rotation_about, rotation_from_zyx, zyx_from_rotation

R_LEAP_REFERENCE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Attitude:
    """Yaw, pitch and roll of a hand [rad]."""

    yaw: float
    pitch: float
    roll: float

    def clipped(self, limits: Attitude) -> Attitude:
        """Returns the attitude with each angle within plus and minus its limit."""
        return Attitude(
            *(
                float(np.clip(angle, -limit, limit))
                for angle, limit in zip((self.yaw, self.pitch, self.roll), (limits.yaw, limits.pitch, limits.roll))
            )
        )


def attitude(R_leap_hand: np.ndarray, heading: float) -> Attitude:
    """Returns the attitude of the hand relative to the reference hand turned to `heading` [rad].

    Two triples of angles describe each orientation; this returns the one with the smaller sum. So a hand pitched beyond
    the vertical has a pitch above 90 deg, and its yaw does not flip by 180 deg from one limit to the other.

    Args:
        R_leap_hand: rotation of the hand frame, shape (3, 3).
        heading: see virtual_leap [rad].
    """
    yaw, pitch, roll = zyx_from_rotation(R_LEAP_REFERENCE.T @ R_leap_hand)
    near = Attitude(_wrapped(yaw - heading), pitch, roll)
    far = Attitude(_wrapped(near.yaw + math.pi), _wrapped(math.pi - pitch), _wrapped(roll + math.pi))
    return min(near, far, key=lambda a: abs(a.yaw) + abs(a.pitch) + abs(a.roll))


def tool_rotation(angles: Attitude, heading: float, turned: bool) -> np.ndarray:
    """Returns R_virtual_tool, shape (3, 3).

    Args:
        angles: attitude of the hand, clipped.
        heading: the heading that the yaw is counted from [rad].
        turned: turn by 180 deg about the tool's z axis, as the home pose has it (see common.mounting).
    """
    R_reference_tool = rotation_from_zyx(angles.yaw + heading, angles.pitch, angles.roll)
    R_virtual_tool = R_LEAP_REFERENCE @ R_reference_tool
    return R_virtual_tool @ rotation_about(2, math.pi) if turned else R_virtual_tool


def _wrapped(angle: float) -> float:
    """Returns the angle [rad] within (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
