"""The mean of the newest samples of one hand, without outliers.

An outlier is a palm that moves more than 20 mm from one frame to the next, and faster than 2 m/s over a longer gap, or
a hand with invalid numbers (docs/handbook/wire-protocols.md, "Tracker: Leap service"). The mean does not change while
outliers come in. After MAX_LEFT_OUT of them in a row the hand counts as lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from common.averaging import Window
from common.poses import pose, read_only
from leap_kuka.hand_frame import hand_fault, hand_rotation
from leap_motion.tracking import TrackedHand

MAX_STEP_M = 0.02
MAX_SPEED_M_S = 2.0
MAX_LEFT_OUT = 5

SPEED_SAMPLES = 10
"""Number of samples from which the speed of the palm is computed, whatever the size of the mean."""

MIN_MEAN_LENGTH = 0.8
"""Shortest mean of unit vectors that counts as a direction. Above 1/sqrt(2) the means of direction and normal cannot
be parallel: the samples are orthogonal, so the cosine between the means is at most (1 - l^2) / l^2."""


@dataclass(frozen=True)
class MeanHand:
    """The averaged hand.

    Attributes:
        T_leap_hand: pose of the hand frame in the Leap frame, shape (4, 4) [m].
        confidence: 0 to 1.
        speed: of the palm over the newest samples [m/s]; infinite while it is unknown.
    """

    T_leap_hand: np.ndarray
    confidence: float
    speed: float

    @property
    def palm(self) -> np.ndarray:
        """Palm centre in the Leap frame, shape (3,) [m]."""
        return self.T_leap_hand[:3, 3]


class HandAverage:
    """First-in, first-out mean over `size` samples of one hand; `left_out` counts the newest outliers in a row."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._window = Window(size)
        self.reset()

    def reset(self) -> None:
        """Forgets all samples."""
        self._window.reset()
        self._newest: deque[tuple[np.ndarray, float]] = deque(maxlen=SPEED_SAMPLES)
        self.count = 0
        self.left_out = 0

    @property
    def lost(self) -> bool:
        """Whether the hand counts as lost after too many outliers in a row."""
        return self.left_out >= MAX_LEFT_OUT

    def add(self, hand: TrackedHand, now: float) -> str | None:
        """Adds the sample of the time `now` [s]; returns why it was left out, or None."""
        fault = hand_fault(hand) or self._outlier(hand.palm, now)
        if fault:
            self.left_out += 1
            return fault
        self.left_out = 0
        self._newest.append((hand.palm, now))
        self._window.add(np.concatenate([hand.palm, hand.direction, hand.normal, [hand.confidence]]))
        self.count = min(self.count + 1, self.size)
        return None

    def mean(self) -> MeanHand | None:
        """Returns the mean hand, or None while the window fills or the hand turns too fast for a mean."""
        mean = self._window.mean()
        if mean is None or min(np.linalg.norm(mean[3:6]), np.linalg.norm(mean[6:9])) < MIN_MEAN_LENGTH:
            return None
        return MeanHand(read_only(pose(hand_rotation(mean[3:6], mean[6:9]), mean[:3])), float(mean[9]), self._speed())

    def _speed(self) -> float:
        elapsed = self._newest[-1][1] - self._newest[0][1]
        steps = np.diff([palm for palm, _ in self._newest], axis=0)
        return float(np.sum(np.linalg.norm(steps, axis=1))) / elapsed if elapsed > 0.0 else math.inf

    def _outlier(self, palm: np.ndarray, now: float) -> str | None:
        if not self._newest:
            return None
        step = float(np.linalg.norm(palm - self._newest[-1][0]))
        elapsed = now - self._newest[-1][1]
        if step <= max(MAX_STEP_M, MAX_SPEED_M_S * elapsed):
            return None
        return f"the palm jumped by {1e3 * step:.0f} mm within {1e3 * elapsed:.0f} ms"
