"""Whether a measure of a running program grows: the slope of its curve after the warm-up, with its interval. The slope
is the median of the slopes between all pairs of points (Theil 1950, Sen 1968): peaks, as while a fault lasts, hardly
move it. The points are medians of blocks, which are nearly independent of each other, as the interval needs. Written
here, because scipy would be 40 MB more to install for these formulas."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

WARM_UP = 0.25  # fraction of the run, at most WARM_UP_HOURS
WARM_UP_HOURS = 0.5
BLOCKS = 36
LEAST_SAMPLES = 12
Z_99 = 2.575829  # of the normal distribution, two-sided 99 %


class Growth(NamedTuple):
    """The slope of a curve, an hour, the ends of its 99 % interval, and the median of the curve after the warm-up."""

    slope: float
    low: float
    high: float
    level: float

    def verdict(self, bound: float) -> str:
        """Returns "grows" or "steady" where the whole interval lies above or below the bound, else "unclear"."""
        return "grows" if self.low > bound else "steady" if self.high <= bound else "unclear"


def growth(hours: np.ndarray, values: np.ndarray) -> Growth | None:
    """Returns the growth of a measure, None where there are too few samples after the warm-up.

    Args:
        hours: times since the start, rising, shape (n,) [h].
        values: the measure at these times, shape (n,); NaN where it is missing."""
    hours, values = np.asarray(hours, dtype=float), np.asarray(values, dtype=float)
    known = np.isfinite(values)
    if known.any():
        known &= hours >= hours[0] + min(WARM_UP * (hours[-1] - hours[0]), WARM_UP_HOURS)
    t, x = hours[known], values[known]
    if len(t) < LEAST_SAMPLES:
        return None
    blocks = min(BLOCKS, len(t) // 3)
    middles = np.array(
        [(np.median(a), np.median(b)) for a, b in zip(np.array_split(t, blocks), np.array_split(x, blocks))]
    )
    i, j = np.triu_indices(blocks, 1)
    slopes = np.sort((middles[j, 1] - middles[i, 1]) / (middles[j, 0] - middles[i, 0]))
    # Sen's interval: of N sorted slopes those whose ranks are C/2 from the middle, C from Kendall's variance
    half = 0.5 * Z_99 * np.sqrt(blocks * (blocks - 1) * (2 * blocks + 5) / 18.0)
    n = len(slopes)
    low, high = int(np.floor(0.5 * n - half)) - 1, int(np.ceil(0.5 * n + half))
    return Growth(
        float(np.median(slopes)),
        float(slopes[low]) if low >= 0 else -np.inf,
        float(slopes[high]) if high < n else np.inf,
        float(np.median(x)),
    )
