"""The hand model of the Leap service: one scaled template with a rigid palm and hinged fingers. Millimetres in Leap
axes (x to the user's right, y up, z towards the user), or in palm axes where stated: x to the pinky's side, y out of
the back of the hand, z to the wrist. Palm axes of a left hand are mirrored, so one template serves both hands; so are
the bases of its bones, as on the wire of the service."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.rotations import rotation_about, unit
from leap_motion.service.hand import (
    ARM_LENGTH_MM,
    ARM_WIDTH_MM,
    FINGER_WIDTHS_MM,
    KNUCKLES_MM,
    PALM_WIDTH_MM,
    TIP_ON_DISTAL,
    WRIST_MM,
)

BONE_LENGTHS_MM = np.array(
    [
        [0.0, 46.22, 31.57, 21.67],
        [68.12, 39.78, 22.38, 15.82],
        [64.60, 44.63, 26.33, 17.40],
        [58.00, 41.37, 25.65, 17.30],
        [53.69, 32.74, 18.11, 15.96],
    ]
)
"""Metacarpal to distal (columns) of thumb to pinky (rows); the bones of the thumb count one joint further out."""
CARPS_MM = np.array(
    [[-19.34, -6.00, 53.17], [-11.87, 12.10, 43.26], [-0.88, 13.58, 40.60], [10.41, 12.60, 39.65], [21.41, 5.68, 41.81]]
)
R_THUMB = rotation_about(2, np.radians(45.0))  # of its hinges about its bones: it bends across the palm, not down
OPEN = np.radians([[-5, 4, 4], [2, 5, 4], [1, 5, 4], [2, 5, 4], [3, 6, 5]])
FIST = np.radians([[25, 40, 50], [85, 85, 62], [87, 86, 62], [87, 86, 62], [86, 85, 62]])
OPEN_SPREAD = np.radians([-40.0, -3.0, 1.0, 5.0, 12.0])
FIST_SPREAD = np.radians([-8.0, 0.0, 0.0, 1.0, 2.0])


@dataclass(frozen=True)
class HandPose:
    """Pose of a hand and flexion of its fingers."""

    palm: np.ndarray  # centre of the palm, shape (3,) [mm]
    pitch: float  # fingers up is positive [rad]
    yaw: float  # fingers to the right is positive [rad]
    roll: float  # palm facing right is positive [rad]
    flexion: np.ndarray  # of the three hinges of thumb to pinky, shape (5, 3) [rad]
    spread: np.ndarray  # of thumb to pinky at the knuckle, to the pinky's side positive, shape (5,) [rad]


@dataclass(frozen=True)
class HandGeometry:
    """Geometry of the bones of a hand."""

    palm: np.ndarray  # shape (3,) [mm]
    direction: np.ndarray  # unit vector, shape (3,)
    normal: np.ndarray  # unit vector, shape (3,)
    joints: np.ndarray  # carp, mcp, pip, dip, btip of thumb to pinky, shape (5, 5, 3) [mm]
    bases: np.ndarray  # axes x, y, z as rows of metacarpal to distal, shape (5, 4, 3, 3); mirrored on a left hand
    tips: np.ndarray  # centres of the finger tips, shape (5, 3) [mm]
    elbow: np.ndarray  # shape (3,) [mm]
    wrist: np.ndarray  # shape (3,) [mm]
    arm_basis: np.ndarray  # axes x, y, z of the forearm as rows, shape (3, 3); mirrored on a left hand


def fingers_for(curl: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns flexion and spread of the fingers between the open hand (curl 0) and the fist (curl 1)."""
    return OPEN + curl * (FIST - OPEN), OPEN_SPREAD + curl * (FIST_SPREAD - OPEN_SPREAD)


class HandModel:
    """A hand of one side, "right" or "left", of `scale` against the template (adults have 1.03 to 1.10); `ends_at_tip`:
    whether the last bone ends at the tip centre, as with newer services; `T_desk_leap`: pose of the device where the
    poses of the hand are, shape (4, 4) [mm]."""

    def __init__(
        self,
        side: str = "right",
        scale: float = 1.05,
        ends_at_tip: bool = False,
        T_desk_leap: np.ndarray | None = None,
    ) -> None:
        if side not in ("right", "left"):
            raise ValueError(f"The side is {side!r}, but must be right or left.")
        self.side, self.scale, self.ends_at_tip = side, scale, ends_at_tip
        self._T_desk_leap = T_desk_leap
        self.lengths = BONE_LENGTHS_MM * scale
        if ends_at_tip:
            self.lengths[:, 3] *= TIP_ON_DISTAL
        tips = TIP_ON_DISTAL * scale * BONE_LENGTHS_MM[:, 3]
        self.finger_lengths = 0.5 * self.lengths[:, 1] + self.lengths[:, 2] + tips  # thumb to pinky [mm]
        self.finger_lengths[0] -= 0.5 * self.lengths[0, 1]
        self.finger_widths, self.arm_width = FINGER_WIDTHS_MM * scale, ARM_WIDTH_MM * scale  # [mm]
        self.palm_width = PALM_WIDTH_MM * scale  # [mm]
        self._carps, self._knuckles, self._wrist = CARPS_MM * scale, KNUCKLES_MM * scale, WRIST_MM * scale
        self._metacarpals = np.array([_across(carp - knuckle) for carp, knuckle in zip(CARPS_MM, KNUCKLES_MM)])

    def place(self, pose: HandPose) -> HandGeometry:
        """Returns the geometry of the bones in a pose of the hand."""
        # Yaw, pitch and roll of the service are projections of these two orthogonal vectors.
        dx, dy, dz = _unit(math.tan(pose.yaw), math.tan(pose.pitch), -1.0)
        sine, cosine = math.sin(pose.roll), math.cos(pose.roll)
        nx, ny, nz = _unit(sine, -cosine, -(dx * sine - dy * cosine) / dz)
        side = -1.0 if self.side == "left" else 1.0
        across = side * (ny * dz - nz * dy), side * (nz * dx - nx * dz), side * (nx * dy - ny * dx)
        # Columns: palm axes in Leap axes.
        axes = np.array([[across[0], -nx, -dx], [across[1], -ny, -dy], [across[2], -nz, -dz]])
        palm = np.asarray(pose.palm, dtype=float)
        if self._T_desk_leap is not None:
            R_leap_desk = self._T_desk_leap[:3, :3].T
            axes, palm = R_leap_desk @ axes, R_leap_desk @ (palm - self._T_desk_leap[:3, 3])
        orientations = self._orientations(pose)
        joints = np.empty((5, 5, 3))
        joints[:, 0], joints[:, 1] = self._carps, self._knuckles
        bones = self.lengths[:, 1:, None] * orientations[:, 1:, :, 2]
        joints[:, 2:] = self._knuckles[:, None] - bones.cumsum(axis=1)
        tip = 1.0 if self.ends_at_tip else TIP_ON_DISTAL
        tips = joints[:, 3] + tip * (joints[:, 4] - joints[:, 3])
        wrist = palm + axes @ self._wrist
        return HandGeometry(
            palm=palm,
            direction=-axes[:, 2],
            normal=-axes[:, 1],
            joints=palm + joints @ axes.T,
            bases=(axes @ orientations).swapaxes(-1, -2),
            tips=palm + tips @ axes.T,
            elbow=wrist + ARM_LENGTH_MM * self.scale * axes[:, 2],
            wrist=wrist,
            arm_basis=axes.T,
        )

    def _orientations(self, pose: HandPose) -> np.ndarray:
        """Returns the orientations of the bones in palm axes, axes as columns, shape (5, 4, 3, 3)."""
        cosine, sine = np.cos(pose.spread), np.sin(pose.spread)
        knuckles = np.zeros((5, 3, 3))  # axes after the spread, a turn about y
        knuckles[:, 0, 0] = knuckles[:, 2, 2] = cosine
        knuckles[:, 0, 2], knuckles[:, 2, 0] = -sine, sine
        knuckles[:, 1, 1] = 1.0
        knuckles[0] = knuckles[0] @ R_THUMB
        bent = pose.flexion.cumsum(axis=1)[:, :, None]
        cosine, sine = np.cos(bent), np.sin(bent)
        x, y, z = knuckles[:, None, :, 0], knuckles[:, None, :, 1], knuckles[:, None, :, 2]
        orientations = np.empty((5, 4, 3, 3))
        orientations[:, 0] = self._metacarpals
        orientations[:, 1:, :, 0] = x
        orientations[:, 1:, :, 1] = cosine * y - sine * z
        orientations[:, 1:, :, 2] = sine * y + cosine * z
        return orientations


def _unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def _across(back: np.ndarray) -> np.ndarray:
    """Returns the orientation of a metacarpal from the vector of its end to its start; identity if it has no length."""
    if not back.any():
        return np.eye(3)
    z = unit(back)
    x = unit(np.array([1.0, 0.0, 0.0]) - z[0] * z)
    return np.stack([x, np.cross(z, x), z], axis=1)
