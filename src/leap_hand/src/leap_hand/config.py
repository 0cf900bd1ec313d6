"""What leap_hand.yaml holds: which angles of the human hand stand for an open and a closed robot hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import vector

FINGERS = ("index", "middle", "thumb", "spread")
"""Order of the angles of the human hand and of the commands of the robot hand."""


@dataclass(frozen=True)
class HandConfig:
    """The parameters under `leap_hand/`: per finger [open, closed], of the human and of the robot hand."""

    index_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to index tip")
    index_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the index finger")
    middle_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to middle tip")
    middle_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the middle finger")
    thumb_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="palm normal to thumb tip")
    thumb_robot: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="command to the thumb")
    spread_human: np.ndarray = vector(2, "deg", low=0.0, high=180.0, doc="index bone to middle bone")
    spread_robot: np.ndarray = vector(2, "deg", low=0.0, high=90.0, doc="command to the spread")

    @property
    def human(self) -> np.ndarray:
        """Angles of the open and of the closed human hand, shape (4, 2) [rad]."""
        return np.radians([getattr(self, f"{finger}_human") for finger in FINGERS])

    @property
    def robot(self) -> np.ndarray:
        """Angles of the open and of the closed robot hand, shape (4, 2) [rad]."""
        return np.radians([getattr(self, f"{finger}_robot") for finger in FINGERS])

    def faults(self) -> list[str]:
        """Returns the limits of the human hand that cannot be told apart."""
        return [
            f"{finger}_human is {getattr(self, f'{finger}_human').tolist()} deg, "
            "but open and closed must differ by 1 deg at least."
            for finger in FINGERS
            if abs(np.diff(getattr(self, f"{finger}_human"))[0]) < 1.0
        ]
