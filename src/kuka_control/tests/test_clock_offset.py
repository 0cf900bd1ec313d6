"""The clock of another machine: what a two-way exchange shows of it, whatever the delays on the way."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kuka_control.model.clock_offset import DRIFT, WIDTH_S, ClockOffset, OffsetMeasurement
from kuka_control.numbers import MAX_OFFSET_S

CLOCK = 1.7e9
PAUSE_S = 0.037
EXACT_S = 1e-5  # rounding of times since 1970, and of the law's own sums [s]
few = settings(max_examples=60, deadline=None)
offsets = st.floats(-2.0 * MAX_OFFSET_S, 2.0 * MAX_OFFSET_S)


def exchange(measurement, offset, begin, delays):
    """Asks a clock that is off by so much [s]; `delays` of request and answer. Returns when that is over."""
    for there, back in delays:
        measurement.answered(begin, begin + there + back, math.floor(begin + there + offset))
        begin += there + back + PAUSE_S
    return begin


@few
@given(offsets, st.floats(0.0, 1.0), st.lists(st.tuples(st.floats(0.0, 2.0), st.floats(0.0, 2.0)), max_size=40))
def test_whatever_the_delays_no_offset_but_the_true_one_is_found(offset, phase, delays):
    measurement = OffsetMeasurement()
    exchange(measurement, offset, CLOCK + phase, delays)
    found = measurement.offset
    assert found is None or abs(found - offset) <= WIDTH_S / 2.0 + EXACT_S


@few
@given(offsets, st.floats(0.0, 1.0), st.floats(0.0, 0.04), st.floats(0.0, 0.04))
def test_on_a_quick_link_a_little_more_than_a_second_of_questions_is_enough(offset, phase, there, back):
    measurement = OffsetMeasurement()
    exchange(measurement, offset, CLOCK + phase, [(there, back)] * math.ceil(1.2 / (there + back + PAUSE_S)))
    assert measurement.offset == pytest.approx(offset, abs=WIDTH_S / 2.0 + EXACT_S)


@few
@given(offsets, st.floats(3.0, 1e4).flatmap(lambda x: st.sampled_from([x, -x])))
def test_a_clock_that_is_set_meanwhile_is_measured_anew(offset, jump):
    measurement = OffsetMeasurement()
    now = exchange(measurement, offset, CLOCK, [(0.01, 0.01)] * 25)
    exchange(measurement, offset + jump, now, [(0.01, 0.01)] * 25)
    assert measurement.offset == pytest.approx(offset + jump, abs=WIDTH_S / 2.0 + EXACT_S)


@few
@given(st.floats(-1e6, 1e6))
def test_a_clock_that_differs_is_corrected_and_one_that_was_never_set_is_not(measured):
    clock = ClockOffset()
    corrected = WIDTH_S < abs(measured) <= MAX_OFFSET_S
    assert clock.measured(measured) == corrected
    assert (clock.value, clock.number) == ((measured, 1) if corrected else (0.0, 0))


@few
@given(st.lists(st.tuples(st.floats(0.0, 100.0), st.floats(-1.0, 1.0).map(lambda x: 5.0 + WIDTH_S * x)), max_size=20))
def test_measurements_that_differ_little_move_the_offset_no_faster_than_clocks_drift(steps):
    clock, now = ClockOffset(), 0.0
    clock.measured(5.0)
    clock.pass_to(now)
    for dt, measured in steps:
        before, number, now = clock.value, clock.number, now + dt
        changed = clock.measured(measured)
        clock.pass_to(now)
        if not changed:
            assert abs(clock.value - before) <= DRIFT * dt + 1e-12 and clock.number == number
            assert abs(clock.value - measured) <= max(abs(before - measured), 1e-12)
        assert abs(clock.value - measured) <= WIDTH_S + 1e-12
