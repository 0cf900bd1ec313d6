"""The rate of a stream of frames: that of the stamps, whatever bursts they come in."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.frame_rate import FrameRate

CLOCK_S = 1.7e9


def rate_of(stamps, window=0.3):
    rate = FrameRate(window)
    for stamp in stamps:
        rate.take(stamp)
    return rate


@given(st.floats(8.0, 200.0), st.floats(0.2, 1.0))
def test_a_steady_stream_has_its_rate(hertz, window):
    rate = rate_of([CLOCK_S + i / hertz for i in range(int(2.0 * window * hertz) + 4)], window)
    assert rate.value == pytest.approx(hertz, rel=1e-4)
    assert window <= rate.span < window + 1.0 / hertz + 1e-5


@given(st.floats(0.02, 0.6), st.integers(2, 5))
def test_bursts_do_not_count_as_a_fast_stream(period, frames):
    rate = rate_of([CLOCK_S + i * period + 0.002 * k for i in range(40) for k in range(frames)])
    assert 0.5 * frames / period <= rate.value <= 2.0 * frames / period


def test_too_few_frames_have_no_rate():
    assert rate_of([]).value is None and rate_of([]).last is None
    assert rate_of([1.0, 1.1]).value is None
    assert rate_of([1.0, 1.0, 1.0]).value is None
    rate = rate_of([1.0, 1.1, 1.2])
    rate.clear()
    assert rate.value is None and rate.span == 0.0
