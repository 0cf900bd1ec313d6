"""Intervals of proportions and medians."""

from __future__ import annotations

import numpy as np
import pytest

from common.statistics import median, paired_difference, proportion


@pytest.mark.parametrize(
    ("k", "n", "low", "high"), [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (95, 100, 0.8882, 0.9785)]
)
def test_wilson_interval(k, n, low, high):
    s = proportion([True] * k + [False] * (n - k))
    assert (s.low, s.high) == pytest.approx((low, high), abs=5e-4)


def test_a_proportion_of_nothing_is_refused():
    with pytest.raises(ValueError):
        proportion([])


def test_a_proportion_as_text():
    assert str(proportion([True] * 95 + [False] * 5)) == "95 (89 to 98), n = 100"


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
    with pytest.raises(ValueError):
        median([])


@pytest.mark.parametrize("statistic", [np.mean, np.median])
def test_a_paired_difference_does_not_mind_what_the_pairs_have_in_common(statistic):
    rng = np.random.default_rng(0)
    common, one, other = rng.normal(0.0, 100.0, 300), rng.normal(1.0, 1.0, 300), rng.normal(0.0, 1.0, 300)
    found, easy = (paired_difference(one + c, other + c, np.mean) for c in (common, 0.0))
    assert found == pytest.approx(easy, abs=1e-9)
    found = paired_difference(one, other, statistic)
    assert 0.0 < found.low < 1.0 < found.high
    same = paired_difference(one, one, statistic)
    assert same == (0.0, 0.0, 0.0)


def test_the_interval_of_a_paired_difference_is_as_wide_as_it_should_be():
    rng = np.random.default_rng(1)
    one, other = rng.normal(0.0, 1.0, 400), rng.normal(0.0, 1.0, 400)
    found = paired_difference(one, other)
    assert found.high - found.low == pytest.approx(2 * 1.96 * np.sqrt(2.0) / 20.0, rel=0.15)
    assert str(found) == f"{found}" == f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f})"
    assert f"{found:+.2f}" == f"{found.value:+.2f} ({found.low:+.2f} to {found.high:+.2f})"


@pytest.mark.parametrize(("one", "other"), [([], []), ([1.0], [1.0, 2.0])])
def test_no_pairs_are_refused(one, other):
    with pytest.raises(ValueError):
        paired_difference(one, other)
