"""The pose of the virtual Leap in the robot's base frame, and the desired orientation of the tool.

The virtual Leap stands upright in the world, below the centre of the workspace. It is turned about its vertical axis so
that one horizontal direction of the real Leap frame, the heading, points forward: along the centre line. A heading is
the angle psi [rad] of a horizontal direction (sin psi, 0, -cos psi) in the Leap frame: 0 points along -z, away from the
user, and positive turns to the right.

The tool has the attitude of the hand, with each angle clipped.
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

from common.mounting import MountingFrame
from common.poses import pose
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
        yaw, pitch, roll = (
            float(np.clip(angle, -limit, limit))
            for angle, limit in zip((self.yaw, self.pitch, self.roll), (limits.yaw, limits.pitch, limits.roll))
        )
        return Attitude(yaw, pitch, roll)


def heading(direction: np.ndarray) -> float:
    """Returns the heading [rad] of a direction in the Leap frame, shape (3,); 0 for one that is vertical."""
    return math.atan2(direction[0], -direction[2])


def virtual_leap_pose(mounting: MountingFrame, ws_center: np.ndarray, height: float, psi: float) -> np.ndarray:
    """Returns T_base_virtual, shape (4, 4).

    The centre of the workspace in the base frame, shape (3,) [m], is `height` [m] above the virtual Leap; the heading
    `psi` [rad] points forward.
    """
    up, forward = mounting.up, mounting.forward
    straight = np.column_stack([np.cross(forward, up), up, -forward])
    return pose(straight @ rotation_about(1, psi), ws_center - height * up)


def attitude(R_leap_hand: np.ndarray, heading: float) -> Attitude:
    """Returns the attitude of the hand frame, shape (3, 3), relative to the reference hand turned to `heading` [rad].

    Two triples of angles describe each orientation; this returns the one with the smaller sum. So a hand pitched beyond
    the vertical has a pitch above 90 deg, and its yaw does not flip by 180 deg from one limit to the other.
    """
    yaw, pitch, roll = zyx_from_rotation(R_LEAP_REFERENCE.T @ R_leap_hand)
    near = Attitude(_wrapped(yaw - heading), pitch, roll)
    far = Attitude(_wrapped(near.yaw + math.pi), _wrapped(math.pi - pitch), _wrapped(roll + math.pi))
    return min(near, far, key=lambda a: abs(a.yaw) + abs(a.pitch) + abs(a.roll))


def tool_rotation(angles: Attitude, heading: float, turned: bool) -> np.ndarray:
    """Returns R_virtual_tool, shape (3, 3), for the clipped attitude of a hand whose yaw counts from `heading` [rad].

    A tool that is `turned` is turned by 180 deg about the tool's z axis, as the home pose has it (see common.mounting).
    """
    R_virtual_tool = R_LEAP_REFERENCE @ rotation_from_zyx(angles.yaw + heading, angles.pitch, angles.roll)
    return R_virtual_tool @ rotation_about(2, math.pi) if turned else R_virtual_tool


def _wrapped(angle: float) -> float:
    """Returns the angle [rad] within (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
