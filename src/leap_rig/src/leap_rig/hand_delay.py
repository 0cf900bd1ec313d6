"""The delay from the hand to the arm: the time by which the tool's motion follows that of the palm.

In each window of time the tool's velocity is fitted as a fixed linear map of the palm's velocity some time before; the
delay is the one of the best fit. The map stands for the virtual Leap's orientation and the scaling, so no frame needs
to be known. Filter, wires, control loop, servo law and drives are all in the delay. A window counts where the palm
moves and the fit explains the tool's motion: not at the bounds of the workspace, nor while the arm catches up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

WINDOW_S, STEP_S = 4.0, 1.0  # length of a window, and time between the beginnings of two
GRID_S = 0.01  # time between two velocities
SPAN_S = 0.04  # time over which a velocity is taken
STEPS = range(-4, 50)  # delays that are tried, in steps of GRID_S
LONGEST_GAP_S = 0.15  # a window with a longer gap between two samples does not count
SLOWEST_M_S = 0.02  # least root mean square speed of the palm, and of the tool
EXPLAINED = 0.8  # least fraction of the tool's motion that the fit explains
FEWEST_WINDOWS = 3


@dataclass(frozen=True)
class HandDelay:
    """The delay over all windows [s]."""

    median: float
    low: float  # 10th percentile
    high: float  # 90th percentile
    windows: int


class Track:
    """Positions over time: the palm or the tool."""

    def __init__(self) -> None:
        self.times: list[float] = []  # rising [s]
        self.positions: list[Sequence[float]] = []  # each shape (3,) [m]

    def add(self, time: float, position: Sequence[float]) -> None:
        """Adds the position, shape (3,) [m], at a time [s], unless that is not after the last one."""
        if not self.times or time > self.times[-1]:
            self.times.append(time)
            self.positions.append(position)


def hand_delay(palm: Track, tool: Track) -> HandDelay | None:
    """Returns the delay of the tool behind the palm, or None where too little moved to tell."""
    if min(len(palm.times), len(tool.times)) < 2:
        return None
    begin, end = max(palm.times[0], tool.times[0]) + SPAN_S, min(palm.times[-1], tool.times[-1]) - SPAN_S
    grid = np.arange(begin, end, GRID_S)
    given, wanted = _velocities(palm, grid), _velocities(tool, grid)
    length, step = round(WINDOW_S / GRID_S), round(STEP_S / GRID_S)
    starts = range(STEPS[-1], len(grid) - length + STEPS[0], step)
    found = (_delay_in_window(given[first - STEPS[-1] :], wanted[first : first + length]) for first in starts)
    delays = [delay for delay in found if delay is not None]
    if len(delays) < FEWEST_WINDOWS:
        return None
    low, median, high = np.percentile(delays, (10, 50, 90)).tolist()
    return HandDelay(median, low, high, len(delays))


def _delay_in_window(given: np.ndarray, wanted: np.ndarray) -> float | None:
    """Returns the delay [s] of the tool's velocities in a window, shape (n, 3) [m/s], or None if it cannot tell.

    The palm's velocities `given` begin the longest delay earlier.
    """
    moved = float(np.square(wanted).sum(axis=1).mean())
    if not moved >= SLOWEST_M_S**2:  # NaN: a gap
        return None
    errors = []
    for step in STEPS:
        first = STEPS[-1] - step
        palm = given[first : first + len(wanted)]
        if not np.square(palm).sum(axis=1).mean() >= SLOWEST_M_S**2:
            return None
        fit = np.linalg.lstsq(palm, wanted, rcond=1e-3)[0]
        errors.append(float(np.square(wanted - palm @ fit).sum(axis=1).mean()) / moved)
    best = int(np.argmin(errors))
    if not 0 < best < len(errors) - 1 or errors[best] > 1.0 - EXPLAINED:
        return None
    left, middle, right = errors[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    return GRID_S * (STEPS[best] + (0.5 * (left - right) / curvature if curvature > 0.0 else 0.0))


def _velocities(track: Track, at: np.ndarray) -> np.ndarray:
    """Returns the velocities, shape (n, 3) [m/s], about the times `at`, shape (n,) [s]; NaN in a gap."""
    times, positions = np.array(track.times), np.array(track.positions, dtype=float)
    ends = [
        np.column_stack([np.interp(at + half, times, column) for column in positions.T])
        for half in (-0.5 * SPAN_S, 0.5 * SPAN_S)
    ]
    velocities = (ends[1] - ends[0]) / SPAN_S
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    velocities[times[after] - times[after - 1] > LONGEST_GAP_S] = np.nan
    return velocities
