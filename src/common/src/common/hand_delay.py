"""The delay from the hand to the arm: the time by which the tool's motion follows that of the palm.

In each window of time the tool's velocity is fitted as a fixed linear map of the palm's velocity some time before; the
delay is the one of the best fit. The map stands for the virtual Leap's orientation and the scaling, so no frame needs
to be known. Filter, wires, control loop, servo law and drives are all in the delay. A window counts where the palm
moves and the fit explains the tool's motion: not at the bounds of the workspace, nor while the arm catches up."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

GRID_S = 0.01  # time between two velocities
SPAN_S = 0.04  # time over which a velocity is taken
STEPS = range(-4, 50)  # delays that are tried, in steps of GRID_S
NEWEST_S, PERIOD_S = 12.0, 4.0  # a live delay is over the newest samples, and is computed anew after this time


@dataclass(frozen=True)
class HandDelay:
    """The delay over all windows [s]."""

    median: float
    low: float  # 10th percentile
    high: float  # 90th percentile
    windows: int


class Track:
    """Positions over time, of the palm or the tool: of the newest `kept` seconds. One thread may add while another one
    reads."""

    def __init__(self, kept: float = math.inf) -> None:
        self._kept = kept
        self.samples: deque[tuple[float, ...]] = deque()  # time, rising [s], and position [m], four numbers

    def add(self, time: float, position: Sequence[float]) -> None:
        """Adds the position, shape (3,) [m], at a time [s], unless that is not after the last one, or not finite."""
        back_s = 1.0  # a stamp earlier than the last one by more means that the clock was set: the track begins anew
        samples = self.samples
        if not all(map(math.isfinite, (time, *position))):
            return
        if samples and time < samples[-1][0] - back_s:
            samples.clear()
        if not samples or time > samples[-1][0]:
            samples.append((time, *position))
        while samples[0][0] < time - self._kept:
            samples.popleft()


class DelayMeter:
    """The delay of the tool behind the palm over the last seconds, while both move."""

    def __init__(self) -> None:
        self.palm = Track(NEWEST_S)
        self.tool = Track(NEWEST_S)
        self._delay: HandDelay | None = None
        self._due = -math.inf

    def at(self, now: float) -> HandDelay | None:
        """Returns the delay at the time `now` [s], by the clock of the samples; None where too little moved to tell. It
        is computed at most every PERIOD_S."""
        if not self._due - PERIOD_S <= now < self._due:
            self._due = now + PERIOD_S
            palm = self.palm.samples
            fresh = bool(palm) and abs(now - palm[-1][0]) < NEWEST_S
            self._delay = hand_delay(self.palm, self.tool) if fresh else None
        return self._delay


def hand_delay(palm: Track, tool: Track) -> HandDelay | None:
    """Returns the delay of the tool behind the palm, or None where too little moved to tell."""
    window_s = 4.0  # length of a window
    step_s = 1.0  # between the beginnings of two windows
    fewest_windows = 3
    palms, tools = np.array(list(palm.samples)), np.array(list(tool.samples))
    if min(len(palms), len(tools)) < 2:
        return None
    begin, end = max(palms[0, 0], tools[0, 0]) + SPAN_S, min(palms[-1, 0], tools[-1, 0]) - SPAN_S
    grid = np.arange(begin, end, GRID_S)
    given, wanted = _velocities(palms, grid), _velocities(tools, grid)
    length, step = round(window_s / GRID_S), round(step_s / GRID_S)
    starts = range(STEPS[-1], len(grid) - length + STEPS[0], step)
    found = (
        _delay_in_window(given[first - STEPS[-1] : first - STEPS[0] + length], wanted[first : first + length])
        for first in starts
    )
    delays = [delay for delay in found if delay is not None]
    if len(delays) < fewest_windows:
        return None
    low, median, high = np.percentile(delays, (10, 50, 90)).tolist()
    return HandDelay(median, low, high, len(delays))


def _delay_in_window(given: np.ndarray, wanted: np.ndarray) -> float | None:
    """Returns the delay [s] of the tool's velocities in a window, shape (n, 3) [m/s], or None if it cannot tell. The
    palm's velocities `given` begin the longest delay earlier, and end the shortest one later."""
    slowest_m_s = 0.02  # least root mean square speed of the palm, and of the tool
    explained = 0.8  # least fraction of the tool's motion that the fit explains
    # square of the palm's speed along one direction as a fraction of another's; less is no motion
    least_motion = 1e-6
    moved = float(np.square(wanted).sum())
    if not moved >= slowest_m_s**2 * len(wanted):  # NaN: a gap
        return None
    # One palm for each delay, the shortest first: shape (delays, 3, n).
    palms = np.lib.stride_tricks.as_strided(
        given, (len(STEPS), 3, len(wanted)), (given.strides[0], given.strides[1], given.strides[0]), writeable=False
    )[::-1]
    squares = palms @ palms.transpose(0, 2, 1)
    if not (np.trace(squares, axis1=1, axis2=2) >= slowest_m_s**2 * len(wanted)).all():
        return None
    products = palms @ wanted
    fits = np.linalg.pinv(squares, rcond=least_motion, hermitian=True) @ products
    errors = (1.0 - (products * fits).sum(axis=(1, 2)) / moved).tolist()
    best = int(np.argmin(errors))
    if not 0 < best < len(errors) - 1 or errors[best] > 1.0 - explained:
        return None
    left, middle, right = errors[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    return GRID_S * (STEPS[best] + (0.5 * (left - right) / curvature if curvature > 0.0 else 0.0))


def _velocities(samples: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Returns the velocities, shape (n, 3) [m/s], about the times `at`, shape (n,) [s]; NaN in a gap. `samples`: times
    [s] and positions [m], shape (m, 4)."""
    longest_gap_s = 0.15  # a window with a longer gap between two samples does not count
    times, positions = samples[:, 0], samples[:, 1:]
    ends = [
        np.column_stack([np.interp(at + half, times, column) for column in positions.T])
        for half in (-0.5 * SPAN_S, 0.5 * SPAN_S)
    ]
    velocities = (ends[1] - ends[0]) / SPAN_S
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    velocities[times[after] - times[after - 1] > longest_gap_s] = np.nan
    return velocities
