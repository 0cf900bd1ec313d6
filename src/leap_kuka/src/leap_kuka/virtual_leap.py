"""The pose of the virtual Leap in the robot's base frame, and the desired orientation of the tool.

The virtual Leap stands upright below the centre of the workspace, turned so that the heading points along the centre
line. A heading is the angle psi [rad] of a horizontal direction (sin psi, 0, -cos psi) in the Leap frame: 0 points away
from the user, positive turns to the right.

The tool has the attitude of the hand, R_reference_hand = Rz(yaw) Ry(pitch) Rx(roll), with each angle clipped: positive
yaw points right, positive pitch up, positive roll lowers the right side (the tracker's own roll is the opposite). The
reference hand lies flat and points away: x = -z_leap, y = x_leap, z = -y_leap. Yaw counts from the heading at the
start.

During a stream the angles are continuous, the nearest to those of the frame before, so a palm that turns past 180 deg
stays at its limit; within UPRIGHT the one triple of the orientation counts. Near a pitch of 90 deg, where yaw and roll
are noise, they stay. The tool never turns by more than 3 times the turn of the hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.mounting import MountingFrame
from common.poses import pose
from common.rotations import rotation_about, rotation_angle, zyx_from_rotation

FULL_TURN = 2.0 * math.pi
UPRIGHT = tuple(
    map(math.radians, (90.0, 60.0, 90.0))
)  # largest yaw, pitch and roll of a hand whose angles are beyond doubt [rad]
TURNED = rotation_about(2, math.pi)
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
            min(max(angle, -limit), limit)
            for angle, limit in zip((self.yaw, self.pitch, self.roll), (limits.yaw, limits.pitch, limits.roll))
        )
        return Attitude(yaw, pitch, roll)

    @property
    def angles(self) -> tuple[float, float, float]:
        """Yaw, pitch and roll [rad]."""
        return self.yaw, self.pitch, self.roll


class SteadyAttitude:
    """The attitude of a hand over the frames of a stream, `measured` and `clipped` to `limits`, without jumps. It
    starts at the orientation R_leap_hand, shape (3, 3), relative to `heading` [rad]."""

    def __init__(self, R_leap_hand: np.ndarray, heading: float, limits: Attitude) -> None:
        self._heading = heading
        self._limits = limits
        self._R_leap_hand = R_leap_hand
        self.measured = attitude(R_leap_hand, heading)
        self.clipped = self.measured.clipped(limits)

    @property
    def limited(self) -> list[str]:
        """Names of the angles that are beyond their limits."""
        limit = self.measured.clipped(self._limits)
        return [name for name in ("yaw", "pitch", "roll") if getattr(limit, name) != getattr(self.measured, name)]

    def follow(self, R_leap_hand: np.ndarray) -> None:
        """Updates both attitudes to the orientation of the hand in the newest frame, shape (3, 3)."""
        stays = 0.2  # cosine of the pitch below which clipped yaw and roll stay
        follows = 0.5  # and from which they follow fully; in between by a share, so that they are continuous
        max_gain = 3.0  # turn of the tool per turn of the hand; up to 45 deg of pitch the angles alone need less
        turn = rotation_angle(self._R_leap_hand.T @ R_leap_hand)
        self._R_leap_hand = R_leap_hand
        self.measured = attitude(R_leap_hand, self._heading, self.measured)
        now, goal = self.clipped.angles, self.measured.clipped(self._limits).angles
        sure = (abs(math.cos(self.measured.pitch)) - stays) / (follows - stays)
        share = min(max(sure, 0.0), 1.0) ** 2
        steps = [f * (g - n) for f, g, n in zip((share, 1.0, share), goal, now)]
        way = sum(map(abs, steps))  # no less than the turn of the tool
        if way > max_gain * turn:
            steps = [max_gain * turn / way * step for step in steps]
        self.clipped = Attitude(*(n + step for n, step in zip(now, steps)))


def heading(direction: np.ndarray) -> float:
    """Returns the heading [rad] of a direction in the Leap frame, shape (3,); 0 for one that is vertical."""
    return math.atan2(direction[0], -direction[2])


def virtual_leap_pose(mounting: MountingFrame, ws_center: np.ndarray, box_center: np.ndarray, psi: float) -> np.ndarray:
    """Returns T_base_virtual, shape (4, 4). The centre of the interaction box in the Leap frame falls on that of the
    workspace in the base frame, shape (3,) [m] each; the heading `psi` [rad] points forward."""
    up, forward = mounting.up, mounting.forward
    straight = np.column_stack([np.cross(forward, up), up, -forward])
    R_base_virtual = straight @ rotation_about(1, psi)
    return pose(R_base_virtual, ws_center - R_base_virtual @ box_center)


def attitude(R_leap_hand: np.ndarray, heading: float, before: Attitude | None = None) -> Attitude:
    """Returns the attitude of the hand frame, shape (3, 3), relative to the reference hand turned to `heading` [rad].
    Of the two triples of angles, plus full turns: the smallest sum if within UPRIGHT, else the nearest to `before`, so
    the yaw of a hand pitched beyond the vertical does not flip by 180 deg from one limit to the other."""
    yaw, pitch, roll = zyx_from_rotation(R_LEAP_REFERENCE.T @ R_leap_hand)
    triples = (yaw - heading, pitch, roll), (yaw - heading + math.pi, math.pi - pitch, roll + math.pi)

    def nearest(centre: tuple[float, float, float]) -> Attitude:
        turned = [[a - FULL_TURN * round((a - c) / FULL_TURN) for a, c in zip(triple, centre)] for triple in triples]
        return Attitude(*min(turned, key=lambda triple: sum(abs(a - c) for a, c in zip(triple, centre))))

    smallest = nearest((0.0, 0.0, 0.0))
    if before is not None and any(abs(angle) > most for angle, most in zip(smallest.angles, UPRIGHT)):
        return nearest(before.angles)
    return smallest
