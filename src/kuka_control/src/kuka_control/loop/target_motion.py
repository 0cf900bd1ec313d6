"""The joint targets between and after the frames that bring them: where the target is now, and how fast it moves.

Frames come at 74 or 115 Hz and unevenly, goals leave at 250 Hz. Between two frames the target continues as it did
before: its stamps say how fast. Goals then pass through the joints of each frame without lag, at any rate of frames.

What keeps it from running on: the speed is the smaller one of that over the last frame and that over the last few, none
where the two differ in sign, so that a hand that slows down or trembles is not carried on; and a frame is continued for
little longer than frames are apart, then the target comes to rest by itself.

The clock of the stamps may be off, and frames are held up on their way. The frame that was held up least among the last
ones tells the difference of the clocks; every other one is taken for as much older as it came later.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.limits.jump import LOST_S

SHORT_S = 0.006
"""Frames nearer in time than this do not tell a speed [s]."""

LONG_S = 0.024
"""Time over which the second opinion about the speed is taken [s]."""

CONTINUED_S = 0.03
"""A frame is continued for one and a half times the time between frames, but never longer than this [s]."""

FADE_S = 0.02
"""Then the target slows down to rest in this time [s]."""

COMPARED = 64
"""So many frames are compared to find the one that was held up least."""


@dataclass(frozen=True)
class MovingTarget:
    """A moving joint target.

    Attributes:
        q: joints, shape (7,) [rad].
        v: their speeds, shape (7,) [rad/s].
    """

    q: np.ndarray
    v: np.ndarray


class TargetMotion:
    """Continues joint targets between frames.

    Args:
        lower, upper: joint ranges, shape (7,) [rad], that no continuation leaves.
        q: joints at the start, shape (7,) [rad], where the target rests.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, q: np.ndarray) -> None:
        self._lower = lower
        self._upper = upper
        self._q = np.asarray(q, dtype=float)
        self._v = np.zeros(7)
        self._since = 0.0
        self._horizon = CONTINUED_S
        self._frames: deque[tuple[float, np.ndarray]] = deque(maxlen=COMPARED)
        self._delays: deque[float] = deque(maxlen=COMPARED)

    @property
    def q(self) -> np.ndarray:
        """The joints of the last frame, shape (7,) [rad]."""
        return self._q

    def take(self, q: np.ndarray, stamp: float, now: float) -> None:
        """Takes the joints of a new frame.

        Args:
            q: joints, shape (7,) [rad].
            stamp: of the frame, by any clock [s].
            now: monotonic time [s].
        """
        if self._frames and not 0.0 < stamp - self._frames[-1][0] <= LOST_S:
            self._frames.clear()
            self._delays.clear()
        self._delays.append(now - stamp)
        self._since = stamp + min(self._delays)
        if self._frames:
            self._horizon = min(1.5 * (stamp - self._frames[-1][0]), CONTINUED_S)
        self._q = np.asarray(q, dtype=float)
        self._v = self._speed(stamp)
        self._frames.append((stamp, self._q))

    def hold(self) -> None:
        """Lets the target rest at the joints of the last frame, as when no new ones can be reached."""
        self._v = np.zeros(7)
        self._frames.clear()

    def at(self, now: float) -> MovingTarget:
        """Returns the target at the monotonic time `now` [s]."""
        age = max(now - self._since, 0.0)
        faded = min(max(age - self._horizon, 0.0), FADE_S)
        way = min(age, self._horizon) + faded - faded * faded / (2.0 * FADE_S)
        free = self._q + way * self._v
        q = np.clip(free, self._lower, self._upper)
        return MovingTarget(read_only(q), read_only(np.where(q == free, (1.0 - faded / FADE_S) * self._v, 0.0)))

    def _speed(self, stamp: float) -> np.ndarray:
        short = self._mean_speed(stamp, SHORT_S)
        long = self._mean_speed(stamp, LONG_S)
        return np.where(short * long > 0.0, np.where(np.abs(short) < np.abs(long), short, long), 0.0)

    def _mean_speed(self, stamp: float, least: float) -> np.ndarray:
        """Returns the mean speed since the newest frame that is `least` seconds old, or since the oldest one."""
        for time, q in reversed(self._frames):
            if stamp - time >= least:
                return (self._q - q) / (stamp - time)
        if not self._frames or stamp - self._frames[0][0] < SHORT_S:
            return np.zeros(7)
        time, q = self._frames[0]
        return (self._q - q) / (stamp - time)
