"""Proportions, medians and differences with their 95 % confidence intervals. Kept instead of scipy.stats: scipy would
be 40 MB more to install for these formulas."""

from __future__ import annotations

from typing import Callable, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 2000


class Proportion(NamedTuple):
    """Successes among trials, with the Wilson interval of their proportion."""

    successes: int
    trials: int
    low: float
    high: float

    @property
    def value(self) -> float:
        return self.successes / self.trials

    def __str__(self) -> str:
        """Returns proportion and interval in percent, and the number of trials."""
        return f"{100 * self.value:.0f} ({100 * self.low:.0f} to {100 * self.high:.0f}), n = {self.trials}"


def proportion(outcomes: ArrayLike) -> Proportion:
    """Returns the proportion of true outcomes; raises ValueError if there are no outcomes."""
    z_95 = 1.959964  # of the normal distribution, two-sided 95 %
    hits = np.asarray(outcomes, dtype=bool)
    n, k = len(hits), int(hits.sum())
    if n == 0:
        raise ValueError("no trials: their proportion is undefined")
    middle = (k + 0.5 * z_95**2) / (n + z_95**2)
    half = z_95 / (n + z_95**2) * np.sqrt(k * (n - k) / n + 0.25 * z_95**2)
    return Proportion(k, n, float(max(0.0, middle - half)), float(min(1.0, middle + half)))


class Estimate(NamedTuple):
    """A statistic of independent cases with its bootstrap interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return format(self, ".1f")

    def __format__(self, spec: str) -> str:
        """Returns value and interval, each in the format given, such as `+.2f`."""
        value, low, high = (format(v, spec or ".1f") for v in self)
        return f"{value} ({low} to {high})"


def median(values: ArrayLike, seed: int = 0) -> Estimate:
    """Returns the median of independent values; raises ValueError if there are no values."""
    values = np.asarray(values, dtype=float)
    if not len(values):
        raise ValueError("no values: their median is undefined")
    found = np.median(np.random.default_rng(seed).choice(values, (RESAMPLES, len(values))), axis=1)
    return Estimate(float(np.median(values)), *np.percentile(found, (2.5, 97.5)).tolist())


def paired_difference(
    one: ArrayLike, other: ArrayLike, statistic: Callable[..., np.ndarray] = np.mean, seed: int = 0
) -> Estimate:
    """Returns the statistic (numpy's mean or median) of `one` less that of `other`, both for the same cases. The
    bootstrap draws whole cases, so that what is common to both, such as a case's difficulty, does not widen the
    interval. Raises ValueError for no cases or different numbers of values."""
    pairs = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    n = len(pairs[0])
    if not n or len(pairs[1]) != n:
        raise ValueError(f"{n} and {len(pairs[1])} values are not pairs")
    drawn = np.random.default_rng(seed).integers(0, n, (RESAMPLES, n))
    a, b = (statistic(values[drawn], axis=1) for values in pairs)
    return Estimate(float(statistic(pairs[0]) - statistic(pairs[1])), *np.percentile(a - b, (2.5, 97.5)).tolist())
