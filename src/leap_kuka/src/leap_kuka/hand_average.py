"""The mean of the newest samples of one hand, without outliers, as the hand frame.

The hand frame has x along the hand, z out of the palm, and y completes it; the same for left and right hands. All
vectors are in the Leap frame: x to the user's right, y up, z towards the user; metres.

The window is in seconds, so that a slow tracker does not add delay: `size` samples at the nominal rate. It holds `size`
samples at most, and two at least.

An outlier is a palm that moves more than 20 mm from one frame to the next, and faster than 2 m/s over a longer gap, or
0.3 m/s over one of more than 0.1 s, or a hand with invalid numbers (docs/handbook/wire-protocols.md, "Tracker: Leap
service"). The mean does not change while outliers come in. After MAX_LEFT_OUT of them in a row the hand counts as lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from common.hand_tracking import plausible_step
from common.poses import pose, read_only
from common.rotations import UNIT_TOLERANCE, unit
from leap_motion.frames import TrackedHand

MAX_LEFT_OUT = 5

NOMINAL_RATE_HZ = 110.0  # of the tracker
SPEED_WINDOW_S = 10.0 / NOMINAL_RATE_HZ  # time over which the speed of the palm is computed, whatever the mean's size
SPEED_SAMPLES = 4  # fewest samples that have a speed
MIN_MEAN_LENGTH = 0.8
"""Shortest mean of unit vectors that counts as a direction. Above 1/sqrt(2) the means of direction and normal cannot
be parallel: the samples are orthogonal, so the cosine between the means is at most (1 - l^2) / l^2."""

ORTHOGONAL_TOLERANCE = 0.01  # largest cosine between direction and normal; the tracker prints them to six digits
MAX_DISTANCE_M = 2.0  # largest distance of a palm from the Leap; the tracker's documented range is 0.6 m


@dataclass(frozen=True)
class MeanHand:
    """The averaged hand."""

    T_leap_hand: np.ndarray  # pose of the hand frame in the Leap frame, shape (4, 4) [m]
    confidence: float  # 0 to 1
    speed: float  # of the palm over SPEED_WINDOW_S [m/s]; infinite while it is unknown

    @property
    def palm(self) -> np.ndarray:
        """Palm centre in the Leap frame, shape (3,) [m]."""
        return self.T_leap_hand[:3, 3]


class HandAverage:
    """First-in, first-out mean over `size` samples of one hand, or `window` [s] if that holds fewer.

    `left_out` counts the newest outliers in a row.
    """

    def __init__(self, size: int) -> None:
        if size < 1:
            raise ValueError(f"the mean needs at least one sample, not {size}")
        self.size, self.window = size, size / NOMINAL_RATE_HZ
        self._samples: deque[tuple[float, np.ndarray]] = deque(maxlen=size)
        self._newest: deque[tuple[float, np.ndarray]] = deque()
        self._first: float | None = None
        self.left_out = 0

    def reset(self) -> None:
        """Forgets all samples."""
        self._samples.clear()
        self._newest.clear()
        self._first = None
        self.left_out = 0

    @property
    def count(self) -> int:
        """Number of samples in the mean."""
        return len(self._samples)

    @property
    def full(self) -> bool:
        """Whether `size` samples are in, or as many as came within the window."""
        if self._first is None or self.count < min(self.size, 2):
            return False
        return self.count == self.size or self._samples[-1][0] - self._first >= self.window

    @property
    def lost(self) -> bool:
        """Whether the hand counts as lost after too many outliers in a row."""
        return self.left_out >= MAX_LEFT_OUT

    def add(self, hand: TrackedHand, now: float) -> str | None:
        """Adds the sample of a frame whose stamp is at `now` [s]; returns why it was left out, or None."""
        fault = hand_fault(hand) or self._outlier(hand.palm, now)
        if fault:
            self.left_out += 1
            return fault
        self.left_out = 0
        self._first = now if self._first is None else self._first
        self._newest.append((now, hand.palm))
        self._samples.append((now, _numbers(hand)))
        _forget(self._newest, now - SPEED_WINDOW_S, SPEED_SAMPLES)
        _forget(self._samples, now - self.window, 2)
        return None

    def mean(self) -> MeanHand | None:
        """Returns the mean hand, or None while the window fills or the hand turns too fast for a mean."""
        if not self.full:
            return None
        mean = np.mean([sample for _, sample in self._samples], axis=0)
        if min(np.linalg.norm(mean[3:6]), np.linalg.norm(mean[6:9])) < MIN_MEAN_LENGTH:
            return None
        return MeanHand(read_only(pose(hand_rotation(mean[3:6], mean[6:9]), mean[:3])), float(mean[9]), self._speed())

    def _speed(self) -> float:
        """Returns the larger speed of the lines through the older and through the newer half of the samples [m/s].

        The length of the path would grow with the noise of every sample; one line alone would call a hand slow that
        turns back within the window.
        """
        if len(self._newest) < SPEED_SAMPLES:
            return math.inf
        times, palms = (np.array(column) for column in zip(*self._newest))
        half = (len(times) + 1) // 2
        return max(_slope(times[:half], palms[:half]), _slope(times[-half:], palms[-half:]))

    def _outlier(self, palm: np.ndarray, now: float) -> str | None:
        if not self._newest:
            return None
        step = float(np.linalg.norm(palm - self._newest[-1][1]))
        elapsed = now - self._newest[-1][0]
        if step <= plausible_step(elapsed):
            return None
        return f"the palm jumped by {1e3 * step:.0f} mm within {1e3 * elapsed:.0f} ms"


def hand_fault(hand: TrackedHand) -> str | None:
    """Returns why the numbers of a hand are invalid, or None."""
    numbers = _numbers(hand)
    if not np.all(np.isfinite(numbers)):
        return f"not all numbers of the hand are finite: {numbers.tolist()}"
    if np.linalg.norm(hand.palm) > MAX_DISTANCE_M:
        return f"the palm is {np.linalg.norm(hand.palm):.1f} m away from the Leap"
    for name in ("direction", "normal"):
        norm = np.linalg.norm(getattr(hand, name))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            return f"the {name} of the hand has length {norm:.4g} instead of 1"
    if abs(hand.direction @ hand.normal) > ORTHOGONAL_TOLERANCE:
        angle = math.degrees(math.acos(np.clip(hand.direction @ hand.normal, -1.0, 1.0)))
        return f"direction and normal of the hand enclose {angle:.1f} deg instead of 90"
    if not 0.0 <= hand.confidence <= 1.0:
        return f"the confidence is {hand.confidence:g} and not within 0 and 1"
    return None


def hand_rotation(direction: ArrayLike, normal: ArrayLike) -> np.ndarray:
    """Returns R_leap_hand, shape (3, 3), with x along `direction` and z closest to `normal`, shape (3,), of any length.

    Raises:
        ValueError: a vector has no direction, or both have the same.
    """
    x, normal = unit(direction), unit(normal)
    z = unit(normal - (normal @ x) * x)
    return np.column_stack([x, np.cross(z, x), z])


def _forget(samples: deque[tuple[float, np.ndarray]], until: float, least: int) -> None:
    """Removes the samples that are not after `until` [s], but keeps `least` of them."""
    while len(samples) > least and samples[0][0] <= until:
        samples.popleft()


def _slope(times: np.ndarray, points: np.ndarray) -> float:
    """Returns the speed of the line that fits points, shape (n, 3) [m], at times, shape (n,) [s], best [m/s]."""
    centred = times - times.mean()
    square = float(centred @ centred)
    return float(np.linalg.norm(centred @ points)) / square if square > 0.0 else math.inf


def _numbers(hand: TrackedHand) -> np.ndarray:
    return np.concatenate([hand.palm, hand.direction, hand.normal, [hand.confidence]])
