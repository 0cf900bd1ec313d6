"""The hand frame of one hand over its newest samples, without outliers, filtered against tremor: x along the hand, z
out of the palm, y completes it, for left and right hands alike. Vectors are in the Leap frame [m].

The window is in seconds, so that a slow tracker adds no delay: `size` samples at the nominal rate, at least two. Its
mean gives the confidence, and the frame unless there is a filter (hand_filter.py); above FILTER_SIZE samples the
filter's results are averaged over the rest of the window.

An outlier is a palm that moves more than 20 mm between two frames, and faster than 2 m/s over a longer gap, or 0.3 m/s
over one of more than 0.1 s, or a hand with invalid numbers. After MAX_LEFT_OUT outliers in a row the hand is lost."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from common.hand_tracking import LONG_GAP_S, plausible_step
from common.poses import pose, read_only
from common.rotations import UNIT_TOLERANCE
from leap_kuka.hand_filter import FILTERS
from leap_kuka.numbers import MAX_HAND_DISTANCE_M, MAX_LEFT_OUT, NOMINAL_RATE_HZ, STILL_SAMPLES, STILL_WINDOW_S
from leap_motion.frames import TrackedHand

FILTER_SIZE = 10  # samples; each one more delays a filter's result by half the time between two frames, as a mean's


@dataclass(frozen=True)
class MeanHand:
    """The averaged or filtered hand."""

    T_leap_hand: np.ndarray  # pose of the hand frame in the Leap frame, shape (4, 4) [m]
    confidence: float  # 0 to 1
    speed: float  # of the palm over STILL_WINDOW_S [m/s]; infinite while it is unknown

    @property
    def palm(self) -> np.ndarray:
        """Palm centre in the Leap frame, shape (3,) [m]."""
        return self.T_leap_hand[:3, 3]


class HandAverage:
    """First-in, first-out mean over `size` samples of one hand, or `window` [s] if that holds fewer. A filter of
    FILTERS replaces the mean of the frame, unless it is "mean". `left_out` counts the newest outliers in a row."""

    def __init__(self, size: int, filter: str = "mean") -> None:
        if size < 1:
            raise ValueError(f"the mean needs at least one sample, not {size}")
        self.size = size
        self.window = size / NOMINAL_RATE_HZ
        self._filter = None if filter == "mean" else FILTERS[filter]()
        self._filtered: Sequence[float] = ()
        self._averaged = max(size - FILTER_SIZE, 0) + 1  # results of the filter, at most
        self._results: deque[tuple[float, list[float]]] = deque(maxlen=self._averaged)
        self._samples: deque[tuple[float, list[float]]] = deque(maxlen=size)
        self._newest: deque[tuple[float, list[float]]] = deque()  # palms
        self._first: float | None = None
        self._seen_at = -math.inf  # stamp of the newest sample, of this hand or of the one before [s]
        self._gap_frames = 0  # frames left in which the mean spans a gap
        self.left_out = 0

    def reset(self) -> None:
        self._samples.clear()
        self._newest.clear()
        self._first = None
        self.left_out = 0

    @property
    def count(self) -> int:
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

    @property
    def spans_gap(self) -> bool:
        """Whether the mean holds samples from both sides of a gap in which nobody saw where the hand was."""
        return self._gap_frames > 0

    def add(self, hand: TrackedHand, now: float) -> str | None:
        """Adds the sample of a frame whose stamp is at `now` [s]; returns why it was left out, or None."""
        numbers = _numbers(hand)
        fault = _fault(numbers) or self._outlier(numbers[:3], now)
        if fault:
            self.left_out += 1
            return fault
        self.left_out = 0
        gap = now - self._seen_at > LONG_GAP_S
        self._gap_frames = 2 if gap else max(self._gap_frames - 1, 0)
        self._seen_at = now
        if self._filter is not None:
            self._filtered = self._after(numbers[:9], now, gap and bool(self._samples))
        self._first = now if self._first is None else self._first
        self._newest.append((now, numbers[:3]))
        self._samples.append((now, numbers))
        _forget(self._newest, now - STILL_WINDOW_S, STILL_SAMPLES)
        _forget(self._samples, now - self.window, 2)
        return None

    def mean(self) -> MeanHand | None:
        """Returns the mean hand, or None while the window fills or the hand turns too fast for a mean."""
        if not self.full:
            return None
        *vectors, confidence = _mean(self._samples)
        if not _is_frame(vectors):
            return None
        if self._filter is not None:
            vectors = list(self._filtered)
            if not _is_frame(vectors):
                return None
        return MeanHand(_pose(vectors), confidence, self._speed())

    def _after(self, sample: list[float], now: float, gap: bool) -> Sequence[float]:
        """Returns the filtered sample, nine numbers: the mean of the filter's newest results. A filter begins anew
        after a gap. The first result is half-way then, as the mean's is, so
        that the tool makes two smaller steps."""
        assert self._filter is not None, "only a filter has a state of its own"
        if gap or not self._samples:
            self._filter.reset()
            self._results.clear()
        filtered = self._filter.step(sample, now)
        if self._averaged > 1:
            self._results.append((now, list(filtered)))
            _forget(self._results, now - self._averaged / NOMINAL_RATE_HZ, 1)
            filtered = _mean(self._results)
        return [0.5 * (a + b) for a, b in zip(self._filtered, filtered)] if gap else filtered

    def _speed(self) -> float:
        """Returns the larger speed of the lines through the older and through the newer half of the samples [m/s].
        The length of the path would grow with the noise of every sample; one line alone would call a hand slow that
        turns back within the window."""
        if len(self._newest) < STILL_SAMPLES:
            return math.inf
        samples = list(self._newest)
        half = (len(samples) + 1) // 2
        return max(_slope(samples[:half]), _slope(samples[-half:]))

    def _outlier(self, palm: list[float], now: float) -> str | None:
        if not self._newest:
            return None
        step = math.dist(palm, self._newest[-1][1])
        elapsed = now - self._newest[-1][0]
        if step <= plausible_step(elapsed):
            return None
        return f"the palm jumped by {1e3 * step:.0f} mm within {1e3 * elapsed:.0f} ms"


def hand_fault(hand: TrackedHand) -> str | None:
    """Returns why the numbers of a hand are invalid, or None."""
    return _fault(_numbers(hand))


def hand_frame(hand: TrackedHand) -> np.ndarray:
    """Returns T_leap_hand, shape (4, 4) [m], of one sample whose numbers are valid."""
    return _pose(_numbers(hand))


def _pose(numbers: Sequence[float]) -> np.ndarray:
    return read_only(pose(hand_rotation(numbers[3:6], numbers[6:9]), numbers[:3]))


def _fault(numbers: list[float]) -> str | None:
    if not all(map(math.isfinite, numbers)):
        return f"not all numbers of the hand are finite: {numbers}"
    palm, direction, normal, confidence = numbers[:3], numbers[3:6], numbers[6:9], numbers[9]
    if math.hypot(*palm) > MAX_HAND_DISTANCE_M:
        return f"the palm is {math.hypot(*palm):.1f} m away from the Leap"
    for name, vector in (("direction", direction), ("normal", normal)):
        norm = math.hypot(*vector)
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            return f"the {name} of the hand has length {norm:.4g} instead of 1"
    cosine = _dot(direction, normal)
    orthogonal_tolerance = 0.01  # the tracker prints them to six digits
    if abs(cosine) > orthogonal_tolerance:
        angle = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
        return f"direction and normal of the hand enclose {angle:.1f} deg instead of 90"
    if not 0.0 <= confidence <= 1.0:
        return f"the confidence is {confidence:g} and not within 0 and 1"
    return None


def hand_rotation(direction: Sequence[float] | np.ndarray, normal: Sequence[float] | np.ndarray) -> np.ndarray:
    """Returns R_leap_hand, shape (3, 3), with x along `direction` and z closest to `normal`, shape (3,), of any
    length. Raises ValueError: a vector has no direction, or both have the same."""
    x, n = _unit(direction), _unit(normal)
    along = _dot(n, x)
    z = _unit([a - along * b for a, b in zip(n, x)])
    y = (z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0])
    return np.array([x, y, z]).T


def _is_frame(vectors: Sequence[float]) -> bool:
    min_length = 0.8  # of a mean of unit vectors that counts as a direction
    max_cosine = 0.7  # the samples are orthogonal: between means of that length it is at most (1 - l^2) / l^2 = 0.56
    direction, normal = vectors[3:6], vectors[6:9]
    lengths = math.hypot(*direction), math.hypot(*normal)
    return min(lengths) >= min_length and abs(_dot(direction, normal)) <= max_cosine * lengths[0] * lengths[1]


def _unit(vector: Sequence[float] | np.ndarray) -> list[float]:
    x, y, z = map(float, vector)
    norm = math.hypot(x, y, z)
    if not 1e-12 <= norm < math.inf:
        raise ValueError(f"the vector {[x, y, z]} has no direction")
    return [x / norm, y / norm, z / norm]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _forget(samples: deque[tuple[float, list[float]]], until: float, least: int) -> None:
    """Removes the samples that are not after `until` [s], but keeps `least` of them."""
    while len(samples) > least and samples[0][0] <= until:
        samples.popleft()


def _mean(samples: deque[tuple[float, list[float]]]) -> list[float]:
    return [sum(column) / len(samples) for column in zip(*(numbers for _, numbers in samples))]


def _slope(samples: list[tuple[float, list[float]]]) -> float:
    """Returns the speed of the line that fits points [m] at times [s] best [m/s]."""
    middle = sum(time for time, _ in samples) / len(samples)
    square = x = y = z = 0.0
    for time, point in samples:
        centred = time - middle
        square += centred * centred
        x, y, z = x + centred * point[0], y + centred * point[1], z + centred * point[2]
    return math.hypot(x, y, z) / square if square > 0.0 else math.inf


def _numbers(hand: TrackedHand) -> list[float]:
    return [*hand.palm.tolist(), *hand.direction.tolist(), *hand.normal.tolist(), float(hand.confidence)]
