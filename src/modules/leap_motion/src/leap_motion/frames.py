"""Tracking frames as records.

All vectors are in Leap axes: origin on top of the device, x along its long edge to the user's right, y up, z towards
the user. Lengths are in metres, angles in radians, speeds in metres per second. Arrays are read-only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

THUMB, INDEX, MIDDLE, RING, PINKY = range(5)
METACARPAL, PROXIMAL, INTERMEDIATE, DISTAL = range(4)


@dataclass(frozen=True)
class LeapBone:
    """One bone of a finger, or the forearm.

    Attributes:
        start: end nearer to the body, shape (3,) [m].
        end: end nearer to the finger tip, shape (3,) [m].
        rotation: orientation of the bone, shape (3, 3), a proper rotation for both hands. Columns: x across the finger,
            y out of its back, z against the bone's direction. On a right hand x points to the pinky's side, on a left
            hand to the thumb's side.
    """

    start: np.ndarray
    end: np.ndarray
    rotation: np.ndarray

    @property
    def length(self) -> float:
        """Distance of the two ends [m]; 0 where the service does not report the start."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def center(self) -> np.ndarray:
        """Midpoint, shape (3,) [m]."""
        return 0.5 * (self.start + self.end)


@dataclass(frozen=True)
class LeapFinger:
    """One finger.

    Attributes:
        id: 10 * id of the hand + type.
        type: THUMB to PINKY.
        bones: METACARPAL to DISTAL. The metacarpal of the thumb has no length.
        tip: centre of the finger tip, shape (3,) [m]; a few millimetres before the end of the last bone.
        length: as the service reports it [m]; the bones are the better source.
        width: as the service reports it [m].
        extended: whether the finger points straight.
    """

    id: int
    type: int
    bones: tuple[LeapBone, ...]
    tip: np.ndarray
    length: float
    width: float
    extended: bool


@dataclass(frozen=True)
class LeapHand:
    """One hand.

    Attributes:
        id: constant while the hand is tracked, new after every loss, rising.
        side: "right" or "left".
        palm: centre of the palm, shape (3,) [m].
        normal: unit vector out of the palm, shape (3,).
        direction: unit vector from the palm to the fingers, shape (3,).
        velocity: of the palm, shape (3,) [m/s]; zero where unknown.
        confidence: how well the model fits the image, 0 to 1.
        grab: 0 open to 1 fist.
        pinch: 0 open to 1 thumb on a finger.
        time_visible: as the service reports it [s]; early services report the time since their own start.
        palm_width: [m]; 0 where unknown.
        sphere_center: centre of a ball the hand would hold, shape (3,) [m]; zero where unknown.
        sphere_radius: its radius [m]; 0 where unknown.
        fingers: sorted by type; five, unless the service sent fewer.
        arm: forearm from elbow to wrist, or None where unknown.
    """

    id: int
    side: str
    palm: np.ndarray
    normal: np.ndarray
    direction: np.ndarray
    velocity: np.ndarray
    confidence: float
    grab: float
    pinch: float
    time_visible: float
    palm_width: float
    sphere_center: np.ndarray
    sphere_radius: float
    fingers: tuple[LeapFinger, ...]
    arm: LeapBone | None

    @property
    def is_left(self) -> bool:
        """Whether it is a left hand."""
        return self.side == "left"

    @property
    def pitch(self) -> float:
        """Angle of the direction above the horizontal [rad]: fingers up is positive."""
        return math.atan2(self.direction[1], -self.direction[2])

    @property
    def yaw(self) -> float:
        """Angle of the direction from the device's -z axis [rad]: fingers to the right is positive."""
        return math.atan2(self.direction[0], -self.direction[2])

    @property
    def roll(self) -> float:
        """Angle of the palm normal from straight down [rad]: palm facing right is positive."""
        return math.atan2(self.normal[0], -self.normal[1])


@dataclass(frozen=True)
class LeapFrame:
    """One tracking frame.

    Attributes:
        id: rises from frame to frame.
        timestamp_us: capture time on the device's own clock [us]; the source for time differences.
        rate: the service's estimate of the frame rate [Hz].
        hands: in the order of the service.
        gestures: number of gestures; zero unless the client asked for them.
    """

    id: int
    timestamp_us: int
    rate: float
    hands: tuple[LeapHand, ...]
    gestures: int = 0

    @property
    def finger_count(self) -> int:
        """Number of fingers of all hands."""
        return sum(len(hand.fingers) for hand in self.hands)

    def hand(self, side: str) -> LeapHand | None:
        """Returns the hand of that side with the lowest id, which is tracked longest, or None."""
        hands = [hand for hand in self.hands if hand.side == side]
        return min(hands, key=lambda hand: hand.id) if hands else None
