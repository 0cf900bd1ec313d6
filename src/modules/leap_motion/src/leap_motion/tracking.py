"""What teleoperation uses of a tracking frame: palm, orientation and finger points of each hand in view.

Vectors are in Leap axes, in metres: x to the user's right, y up, z towards the user. Arrays are read-only.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np


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


def _freeze(record: object, *names: str) -> None:
    for name in names:
        array = np.array(getattr(record, name), dtype=float)
        array.flags.writeable = False
        object.__setattr__(record, name, array)
