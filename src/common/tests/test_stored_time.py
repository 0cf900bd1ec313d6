"""Moments in files and their names."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.stored_time import moment, utc

moments = st.integers(0, 4_000_000_000)


@pytest.fixture(autouse=True, scope="module", params=["UTC0", "CET-1CEST,M3.5.0,M10.5.0/3", "XXX+11:30"])
def zone(request):
    """The time zone of this computer."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", request.param)
        time.tzset()
        yield
    time.tzset()


@given(moments, moments)
def test_texts_are_in_the_order_of_the_moments_and_mean_them(first, second):
    assert (utc(first) < utc(second)) == (first < second)
    assert moment(utc(first)) == first


@pytest.mark.parametrize("text", ["2026-10-25T02:30:00+02:00", "2026-10-25T00:30:00+00:00", "2026-10-25T00:30:00Z"])
def test_another_zone_is_read(text):
    assert moment(text) == 1792888200.0


def test_a_text_without_a_zone_is_of_this_computers():
    assert moment("2026-06-01T12:00:00") == time.mktime((2026, 6, 1, 12, 0, 0, 0, 0, -1))


@pytest.mark.parametrize("text", ["", "yesterday", "Z", "2026-13-01T00:00:00Z", "12:00:00"])
def test_what_is_none_is_refused(text):
    with pytest.raises(ValueError):
        moment(text)
