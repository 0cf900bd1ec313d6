"""Intervals of shares and medians."""

from __future__ import annotations

import numpy as np
import pytest

from common.statistics import median, share


@pytest.mark.parametrize(
    ("k", "n", "low", "high"), [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (95, 100, 0.8882, 0.9785)]
)
def test_wilson_interval(k, n, low, high):
    s = share([True] * k + [False] * (n - k))
    assert (s.low, s.high) == pytest.approx((low, high), abs=5e-4)


def test_a_share_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no trials"):
        share([])


def test_a_share_as_text():
    assert str(share([True] * 95 + [False] * 5)) == "95 (89 to 98), n = 100"


def test_interval_of_a_median_holds_it_and_narrows():
    values = np.random.default_rng(0).normal(3.0, 1.0, 400)
    few, many = median(values[:40]), median(values)
    for found in (few, many):
        assert found.low < 3.0 < found.high
        assert found.low <= found.value <= found.high
    assert many.high - many.low < 0.6 * (few.high - few.low)
    # The interval of a normal distribution's median is 2 x 1.96 x 1.2533 sigma / sqrt(n) wide.
    assert many.high - many.low == pytest.approx(2 * 1.96 * 1.2533 / 20.0, rel=0.35)


def test_a_median_of_nothing_is_refused():
    with pytest.raises(ValueError, match="no median"):
        median([])
