"""A hand as the Leap service reports it, from the positions of its joints. Millimetres, millimetres per second and
seconds, as in the messages; Leap axes: x to the user's right, y up, z towards the user. Palm axes: x to the pinky's
side, y out of the back of the hand, z to the wrist; those of a left hand are mirrored. The service's hand is one
scaled template whose palm is rigid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from leap_motion.codec import bone_axes

PALM_WIDTH_MM = 84.25
ARM_LENGTH_MM, ARM_WIDTH_MM = 250.0, 59.0
FINGER_WIDTHS_MM = np.array([18.75, 17.91, 17.59, 16.738, 14.868])
TIP_ON_DISTAL = 0.77  # position of the finger tip's centre on the last bone in service 2; newer ones end the bone there
KNUCKLES_MM = np.array(
    [[-19.34, -6.00, 53.17], [-23.18, 2.00, -23.15], [-2.79, 4.00, -23.25], [17.45, 4.00, -17.28], [35.34, 0.00, -9.73]]
)
"""Knuckles of thumb to pinky in palm axes, from the centre of the palm; so is the wrist."""
WRIST_MM = np.array([7.06, 4.0, 50.0])
FIRST_VELOCITY_MM_S = 1.19209e-07
FLEXION_SUM_EXTENDED = math.radians(85.0)
COS_THUMB = math.cos(math.radians(45.0))  # the thumb's hinges are turned by 45 degrees: it bends across the palm


@dataclass(frozen=True)
class ReportedHand:
    """A hand as the service reports it."""

    id: int
    side: str  # "right" or "left"
    confidence: float  # 0 to 1
    time_visible: float  # since it came into view [s]
    palm: np.ndarray  # shape (3,) [mm]
    direction: np.ndarray  # unit vector from the palm to the fingers, shape (3,)
    normal: np.ndarray  # unit vector out of the palm, shape (3,)
    joints: np.ndarray  # carp, mcp, pip, dip, btip of thumb to pinky, shape (5, 5, 3) [mm]; carp = mcp for the thumb
    bases: np.ndarray  # axes x, y, z as rows of metacarpal to distal, shape (5, 4, 3, 3); mirrored on a left hand
    tips: np.ndarray  # centres of the finger tips, shape (5, 3) [mm]
    wrist: np.ndarray  # shape (3,) [mm]
    elbow: np.ndarray  # shape (3,) [mm]
    arm_basis: np.ndarray  # axes x, y, z of the forearm as rows, shape (3, 3); mirrored on a left hand
    palm_width: float  # [mm]
    arm_width: float  # [mm]
    lengths: np.ndarray  # of the fingers, shape (5,) [mm]
    widths: np.ndarray  # of the fingers, shape (5,) [mm]
    curl: float  # mean flexion of index to pinky, all their hinges added [rad]
    extended: tuple[bool, ...]  # of thumb to pinky
    velocity: np.ndarray  # of the palm, shape (3,) [mm/s]
    tip_velocities: np.ndarray  # shape (5, 3) [mm/s]
    stable_palm: np.ndarray  # smoothed, shape (3,) [mm]
    stable_tips: np.ndarray  # smoothed, shape (5, 3) [mm]

    @property
    def grab(self) -> float:
        return min(max((math.degrees(self.curl) - 60.0) / 95.0, 0.0), 1.0)

    @property
    def pinch(self) -> float:
        away = self.tips[1:] - self.tips[0]
        distance = math.sqrt((away * away).sum(axis=1).min())
        return min(max((65.5 - distance) / 43.7, 0.0), 1.0)

    def following(self, before: ReportedHand) -> ReportedHand:
        """Returns this hand with the velocities and smoothed positions that follow from the report `before`."""
        velocity_memory = 0.6  # fraction of a filter's value that remains from frame to frame
        stable_memory = 0.8
        dt = self.time_visible - before.time_visible

        def velocity(now: np.ndarray, then: np.ndarray, filtered: np.ndarray) -> np.ndarray:
            return velocity_memory * filtered + (1.0 - velocity_memory) * (now - then) / dt if dt > 0.0 else filtered

        return replace(
            self,
            velocity=velocity(self.palm, before.palm, before.velocity),
            tip_velocities=velocity(self.tips, before.tips, before.tip_velocities),
            stable_palm=stable_memory * before.stable_palm + (1.0 - stable_memory) * self.palm,
            stable_tips=stable_memory * before.stable_tips + (1.0 - stable_memory) * self.tips,
        )


def hand_from_joints(
    hand_id: int,
    side: str,
    joints: np.ndarray,  # carp, mcp, pip, dip, btip of thumb to pinky, shape (5, 5, 3) [mm]; carp = mcp for the thumb
    wrist: np.ndarray,  # shape (3,) [mm]
    time_visible: float,  # since the hand came into view [s]
    confidence: float = 1.0,  # 0 to 1
    before: ReportedHand | None = None,  # the report of the same hand in the frame before
) -> ReportedHand:
    """Returns the report of a hand. Palm and its axes are those of the template that fits the knuckles and the wrist
    best; the forearm, which nobody measures, continues the hand. Raises ValueError for a side, number or joints that
    no hand has."""
    farthest_mm = 1e4
    if side not in ("right", "left"):
        raise ValueError(f"The side of the hand is {side!r}, but must be right or left.")
    joints, wrist = np.array(joints, dtype=float), np.array(wrist, dtype=float)
    if joints.shape != (5, 5, 3) or wrist.shape != (3,):
        raise ValueError(f"The joints have the shape {joints.shape}, the wrist {wrist.shape}; 5 x 5 x 3 and 3 are due.")
    if not ((np.abs(joints) < farthest_mm).all() and (np.abs(wrist) < farthest_mm).all()):
        raise ValueError("A joint of the hand is not finite or more than 10 m away.")
    if not math.isfinite(time_visible):
        raise ValueError(f"The time for which the hand is visible is {time_visible!r}.")
    if not 0.0 <= confidence <= 1.0:
        raise ValueError(f"The confidence of the hand is {confidence!r}, but must be between 0 and 1.")
    mirror = np.array([-1.0 if side == "left" else 1.0, 1.0, 1.0])
    axes, scale, palm = _palm(joints[1:, 1], wrist, mirror)
    hinges = np.repeat(axes[None, None], 5, axis=0)
    x, y = axes[:, 0], axes[:, 1]
    hinges[0, 0, :, 0], hinges[0, 0, :, 1] = COS_THUMB * (x + mirror[0] * y), COS_THUMB * (y - mirror[0] * x)
    bones = np.diff(joints, axis=1)
    lengths = np.linalg.norm(bones, axis=2)
    tips = joints[:, 3] + TIP_ON_DISTAL * bones[:, 3]
    finger_lengths = 0.5 * lengths[:, 1] + lengths[:, 2] + TIP_ON_DISTAL * lengths[:, 3]
    finger_lengths[0] -= 0.5 * lengths[0, 1]
    flexion = _flexion(bones[:, 1:] @ axes)
    hand = ReportedHand(
        id=hand_id,
        side=side,
        confidence=confidence,
        time_visible=time_visible,
        palm=palm,
        direction=-axes[:, 2],
        normal=-axes[:, 1],
        joints=joints,
        bases=bone_axes(joints, hinges).swapaxes(-1, -2) * mirror[:, None],
        tips=tips,
        wrist=wrist,
        elbow=wrist + ARM_LENGTH_MM * scale * axes[:, 2],
        arm_basis=axes.T * mirror[:, None],
        palm_width=PALM_WIDTH_MM * scale,
        arm_width=ARM_WIDTH_MM * scale,
        lengths=finger_lengths,
        widths=FINGER_WIDTHS_MM * scale,
        curl=float(flexion[1:].mean()),
        extended=extended(flexion),
        velocity=np.full(3, FIRST_VELOCITY_MM_S),
        tip_velocities=np.zeros((5, 3)),
        stable_palm=palm,
        stable_tips=tips,
    )
    return hand if before is None else hand.following(before)


def extended(flexion: np.ndarray) -> tuple[bool, ...]:
    """Returns for each finger whether it is extended, from the sum of its hinges' flexion, shape (5,) [rad]."""
    return tuple((flexion < FLEXION_SUM_EXTENDED).tolist())


def _palm(knuckles: np.ndarray, wrist: np.ndarray, mirror: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Returns the palm's axes as columns of a proper rotation, shape (3, 3), its scale and its centre, from the
    knuckles of index to pinky, shape (4, 3), and the wrist (Kabsch 1976)."""
    smallest_scale = 0.4  # of a hand against the template; adults have 0.85 to 1.15
    largest_scale = 2.0
    flatness = 0.05  # least breadth of the palm's points against their length
    template = KNUCKLES_MM[1:] * mirror
    points, places = np.vstack([template, WRIST_MM * mirror]), np.vstack([knuckles, wrist])
    left, stretch, right = np.linalg.svd((points - points.mean(axis=0)).T @ (places - places.mean(axis=0)))
    centre = knuckles.mean(axis=0)
    scale = float(np.linalg.norm(knuckles - centre) / np.linalg.norm(template - template.mean(axis=0)))
    if not smallest_scale <= scale <= largest_scale:
        raise ValueError(f"The knuckles of the hand are those of a palm {PALM_WIDTH_MM * scale:.3g} mm wide.")
    if stretch[1] < flatness * stretch[0]:
        raise ValueError("The knuckles and the wrist of the hand lie on one line.")
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    axes = (left @ right).T
    return axes, scale, centre - scale * axes @ template.mean(axis=0)


def _flexion(bones: np.ndarray) -> np.ndarray:
    """Returns the flexion of all hinges of a finger added, shape (5,) [rad], from its bones in palm axes, proximal
    to distal, shape (5, 3, 3)."""
    bent = np.arctan2(-bones[..., 1], -bones[..., 2])
    turns = (np.diff(bent, axis=1) + math.pi) % (2.0 * math.pi) - math.pi
    flexion = bent[:, 0] + turns.sum(axis=1)
    first, second, third = bones[0] / np.maximum(np.linalg.norm(bones[0], axis=1), 1e-6)[:, None]
    across = math.asin(min(max(-first[1] / COS_THUMB, -1.0), 1.0))
    flexion[0] = across + sum(math.acos(min(max(a @ b, -1.0), 1.0)) for a, b in ((first, second), (second, third)))
    return flexion
