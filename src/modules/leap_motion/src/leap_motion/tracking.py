"""What teleoperation uses of a tracking frame: palm, orientation and finger points of each hand in view.

Vectors are in Leap axes, in metres: x to the user's right, y up, z towards the user. Arrays are read-only.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class FingerPoints:
    """Points of the three fingers that the robot hand has; each of shape (3,) [m].

    Attributes:
        index_tip: tip of the index finger.
        middle_tip: tip of the middle finger.
        thumb_tip: tip of the thumb.
        index_bone: centre of the index finger's intermediate bone.
        middle_bone: centre of the middle finger's intermediate bone.
    """

    index_tip: np.ndarray
    middle_tip: np.ndarray
    thumb_tip: np.ndarray
    index_bone: np.ndarray
    middle_bone: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self, *(field.name for field in fields(self)))


@dataclass(frozen=True)
class TrackedHand:
    """One hand of one tracking frame.

    Attributes:
        id: the tracker's number of this hand.
        is_left: whether it is a left hand.
        palm: centre of the palm, shape (3,) [m].
        direction: unit vector from the palm to the fingers, shape (3,).
        normal: unit vector out of the palm, shape (3,).
        confidence: 0 to 1.
        fingers: points of the fingers, or None unless the hand has five fingers.
    """

    id: int
    is_left: bool
    palm: np.ndarray
    direction: np.ndarray
    normal: np.ndarray
    confidence: float
    fingers: FingerPoints | None = None

    def __post_init__(self) -> None:
        _freeze(self, "palm", "direction", "normal")

    @property
    def name(self) -> str:
        """Side and number, such as "right hand 12"."""
        return f"{'left' if self.is_left else 'right'} hand {self.id}"


@dataclass(frozen=True)
class TrackingFrame:
    """One frame of the tracker.

    Attributes:
        id: the tracker's number of the frame.
        age: time of arrival less the frame's stamp [s].
        hands: the hands in view.
    """

    id: int
    age: float
    hands: tuple[TrackedHand, ...]


def _freeze(record: object, *names: str) -> None:
    for name in names:
        array = np.array(getattr(record, name), dtype=float)
        array.flags.writeable = False
        object.__setattr__(record, name, array)
