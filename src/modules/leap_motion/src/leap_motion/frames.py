"""Tracking frames as records: as the service reports them, and what teleoperation uses of them. All vectors are in
Leap axes: origin on top of the device, x along its long edge to the user's right, y up, z towards the user. Lengths
are in metres, angles in radians, speeds in metres per second. Arrays are read-only."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

THUMB, INDEX, MIDDLE, RING, PINKY = range(5)
METACARPAL, PROXIMAL, INTERMEDIATE, DISTAL = range(4)


@dataclass(frozen=True)
class LeapBone:
    """One bone of a finger, or the forearm."""

    start: np.ndarray  # end nearer to the body, shape (3,) [m]
    end: np.ndarray  # end nearer to the finger tip, shape (3,) [m]
    # orientation of the bone, shape (3, 3), a proper rotation for both hands. Columns: x across the finger, y out
    # of its back, z against the bone's direction. On a right hand x points to the pinky's side, on a left hand to
    # the thumb's side.
    rotation: np.ndarray

    @property
    def length(self) -> float:
        """Distance of the two ends [m]; 0 where the service does not report the start."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def center(self) -> np.ndarray:
        return 0.5 * (self.start + self.end)


@dataclass(frozen=True)
class LeapFinger:
    """One finger."""

    id: int  # 10 * id of the hand + type
    type: int  # THUMB to PINKY
    joints: np.ndarray  # ends of the four bones, from the wrist to the tip, shape (5, 3) [m]
    rotations: np.ndarray  # orientations of the four bones, shape (4, 3, 3), as LeapBone.rotation
    tip: np.ndarray  # centre of the finger tip, shape (3,) [m]; a few millimetres before the end of the last bone
    length: float  # as the service reports it [m]; the bones are the better source
    width: float  # as the service reports it [m]
    extended: bool  # whether the finger points straight

    @property
    def bones(self) -> tuple[LeapBone, ...]:
        """METACARPAL to DISTAL. The metacarpal of the thumb has no length."""
        return tuple(LeapBone(self.joints[i], self.joints[i + 1], self.rotations[i]) for i in range(4))


@dataclass(frozen=True)
class LeapHand:
    """One hand."""

    id: int  # constant while the hand is tracked, new after every loss, rising
    side: str  # "right" or "left"
    palm: np.ndarray  # centre of the palm, shape (3,) [m]
    normal: np.ndarray  # unit vector out of the palm, shape (3,)
    direction: np.ndarray  # unit vector from the palm to the fingers, shape (3,)
    velocity: np.ndarray  # of the palm, shape (3,) [m/s]; zero where unknown
    confidence: float  # how well the model fits the image, 0 to 1
    grab: float  # 0 open to 1 fist
    pinch: float  # 0 open to 1 thumb on a finger
    time_visible: float  # as the service reports it [s]; early services report the time since their own start
    palm_width: float  # [m]; 0 where unknown
    sphere_center: np.ndarray  # centre of a ball the hand would hold, shape (3,) [m]; zero where unknown
    sphere_radius: float  # its radius [m]; 0 where unknown
    fingers: tuple[LeapFinger, ...]  # sorted by type; five, unless the service sent fewer
    arm: LeapBone | None  # forearm from elbow to wrist, or None where unknown

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
    """One tracking frame."""

    id: int  # rises from frame to frame
    timestamp_us: int  # capture time on the device's own clock [us]; the source for time differences
    rate: float  # the service's estimate of the frame rate [Hz]
    hands: tuple[LeapHand, ...]  # in the order of the service
    gestures: int = 0  # number of gestures; zero unless the client asked for them
    left_out: tuple[str, ...] = ()  # why hands or fingers of the service's frame are missing here, a sentence each

    @property
    def finger_count(self) -> int:
        return sum(len(hand.fingers) for hand in self.hands)

    def hand(self, side: str) -> LeapHand | None:
        """Returns the hand of that side with the lowest id, which is tracked longest, or None."""
        hands = [hand for hand in self.hands if hand.side == side]
        return min(hands, key=lambda hand: hand.id) if hands else None


@dataclass(frozen=True)
class FingerPoints:
    """Tips, and centres of intermediate bones, of the fingers that the robot hand has; each of shape (3,) [m]."""

    index_tip: np.ndarray
    middle_tip: np.ndarray
    thumb_tip: np.ndarray
    index_bone: np.ndarray
    middle_bone: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self, *(field.name for field in fields(self)))


@dataclass(frozen=True)
class TrackedHand:
    """One hand of one tracking frame."""

    id: int  # the tracker's number of this hand
    is_left: bool
    palm: np.ndarray  # centre of the palm, shape (3,) [m]
    direction: np.ndarray  # unit vector from the palm to the fingers, shape (3,)
    normal: np.ndarray  # unit vector out of the palm, shape (3,)
    confidence: float  # 0 to 1
    fingers: FingerPoints | None = None  # only of a hand with five fingers
    grab: float = 0.0  # 0 open to 1 fist
    pinch: float = 0.0  # 0 open to 1 thumb on a finger
    joints: np.ndarray | None = None  # LeapFinger.joints of five fingers, shape (5, 5, 3) [m]; only of a skeleton

    def __post_init__(self) -> None:
        _freeze(self, "palm", "direction", "normal")

    @property
    def name(self) -> str:
        """Side and number, such as "right hand 12"."""
        return f"{'left' if self.is_left else 'right'} hand {self.id}"


@dataclass(frozen=True)
class TrackingFrame:
    """One frame of the tracker."""

    id: int  # the tracker's number of the frame
    age: float  # time of arrival less the frame's stamp [s]
    hands: tuple[TrackedHand, ...]  # in view


def int32(number: int) -> int:
    """Returns the low 32 bits as a signed number: what the messages hold of a longer id."""
    return (number + 2**31) % 2**32 - 2**31


def tracked_hands(frame: LeapFrame) -> tuple[TrackedHand, ...]:
    """Returns the hands that teleoperation uses: of each side the one tracked longest."""
    return tuple(_tracked(hand) for side in ("right", "left") if (hand := frame.hand(side)) is not None)


def _tracked(hand: LeapHand) -> TrackedHand:
    points = None
    if [finger.type for finger in hand.fingers] == list(range(5)):
        joints = np.array([finger.joints for finger in hand.fingers])
        centers = 0.5 * (joints[:, INTERMEDIATE] + joints[:, INTERMEDIATE + 1])
        points = FingerPoints(*joints[[INDEX, MIDDLE, THUMB], -1], *centers[[INDEX, MIDDLE]])
    axes = hand.palm, hand.direction, hand.normal
    return TrackedHand(int32(hand.id), hand.side == "left", *axes, hand.confidence, points, hand.grab, hand.pinch)


def _freeze(record: object, *names: str) -> None:
    for name in names:
        array = getattr(record, name)
        if not isinstance(array, np.ndarray) or array.dtype != float or array.flags.writeable:
            array = np.array(array, dtype=float)
            array.flags.writeable = False
            object.__setattr__(record, name, array)
