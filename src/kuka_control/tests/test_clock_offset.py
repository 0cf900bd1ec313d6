"""The clock of another machine is measured from stamps that change and keep their offset; all else stays refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.poses import pose
from kuka_control.model.clock_offset import SPREAD_S, STEADY_COUNT, ClockOffset
from kuka_control.model.desired_frame import (
    MAX_OFFSET_S,
    MAX_SKEW_S,
    PAUSE_S,
    STEADY_S,
    DesiredFrame,
    DesiredStream,
    skew_fault,
)

CLOCK = 1.7e9
T = pose(p=(0.5, 0.0, 0.4))
periods = st.floats(0.008, 0.1)
delays = st.lists(st.floats(0.0, 0.9 * SPREAD_S), min_size=30, max_size=120)
offsets = st.floats(-0.9 * MAX_OFFSET_S, 0.9 * MAX_OFFSET_S).filter(lambda x: abs(x) > MAX_SKEW_S + SPREAD_S)
jumps = st.floats(1.0, 1000.0).flatmap(lambda x: st.sampled_from([x, -x]))


few = settings(max_examples=40, deadline=None)


def in_order(delays, period):
    """Yields delays of frames that do not overtake each other."""
    before = 0.0
    for delay in delays:
        before = min(delay, before + 0.9 * period)
        yield before


class Link:
    """Frames of another machine, from stamp to verdict, as ros/desired_tool.py puts the two steps together."""

    def __init__(self):
        self.clock, self.stream, self.now = ClockOffset(), DesiredStream(), 100.0

    def step(self, dt, stamp=None):
        """Time passes by dt [s], and a frame comes, if it has a stamp; returns what became of it."""
        self.now += dt
        here = CLOCK + self.now
        if stamp is None:
            return self.stream.take(None, here, self.now)
        self.clock.take(stamp, here, self.now)
        corrected = stamp - self.clock.value
        refused = skew_fault(corrected, here)
        if refused is None:
            return self.stream.take(DesiredFrame(T, corrected, clock=self.clock.number), here, self.now)
        return self.stream.take(DesiredFrame(np.eye(4), self.now, refused=refused), here, self.now)

    def frames(self, count, period, offset, delay=0.0):
        """Returns what becomes of so many frames of a clock that is off by so much [s]."""
        return [self.step(period, CLOCK + self.now + period + offset - delay) for _ in range(count)]


@few
@given(periods, st.floats(-0.2, 0.2), delays)
def test_clocks_that_agree_stay_as_they_are(period, offset, delays):
    link = Link()
    for delay in in_order(delays, period):
        assert link.frames(1, period, offset, delay)[0].fresh is not None
    assert (link.clock.value, link.clock.number) == (0.0, 0)


@few
@given(periods, offsets, delays)
def test_a_clock_that_differs_counts_after_half_a_second_and_not_before(period, offset, delays):
    link, began = Link(), None
    accepted = []
    for delay in in_order([*delays, *delays, *delays], period):
        update = link.frames(1, period, offset, delay)[0]
        began = link.now if began is None else began
        accepted.append((link.now - began, update.fresh))
    steady = max(STEADY_S, (STEADY_COUNT - 1) * period)
    assert all(fresh is None for after, fresh in accepted if after < steady - 1e-6)
    assert all(fresh is not None for after, fresh in accepted if after > steady + period + 1e-6)
    assert abs(link.clock.value - offset) <= SPREAD_S + 1e-6
    assert link.clock.number == (accepted[-1][0] >= steady - 1e-6)


@few
@given(periods, offsets, st.integers(2, 200))
def test_a_stamp_that_does_not_change_is_never_measured(period, offset, count):
    link = Link()
    stamp = CLOCK + link.now + offset
    updates = [link.step(period, stamp) for _ in range(count)]
    assert link.clock.number == 0
    assert sum(update.fresh is not None for update in updates) <= (offset > 0.0), "once, when the clock has come to it"


@few
@given(periods, offsets, st.floats(0.0, 3.0).filter(lambda pace: abs(pace - 1.0) > 0.6), st.integers(20, 200))
def test_stamps_at_another_pace_are_never_measured(period, offset, pace, count):
    """A backlog that is worked off, a recording that is played faster, or a clock that almost stands."""
    link = Link()
    start = CLOCK + link.now + offset
    for i in range(1, count):
        link.clock.take(start + pace * i * period, CLOCK + link.now + i * period, link.now + i * period)
        if abs(start + pace * i * period - (CLOCK + link.now + i * period)) > MAX_SKEW_S:
            assert link.clock.number == 0


@few
@given(periods, st.one_of(st.just(0.0), offsets), jumps, st.integers(1, 150))
def test_after_a_jump_nothing_counts_until_the_frames_begin_anew(period, offset, jump, count):
    link = Link()
    link.frames(100, period, offset)
    assert link.stream.silence == 0.0
    silent_from = link.now
    updates = link.frames(count, period, offset + jump)
    assert all(update.fresh is None and update.conflict is None for update in updates)
    if period < 0.03:
        assert link.stream.silence == pytest.approx(link.now - silent_from), "the time-out counts as without frames"
    number = link.stream.number
    back = link.frames(20, period, offset + jump)
    assert all(update.fresh is None for update in back) and link.stream.number == number
    for _ in range(800):
        link.step(0.01)
    updates = link.frames(100, period, offset + jump)
    assert link.stream.number == number + 1
    if abs(offset + jump) < MAX_OFFSET_S - 1.0:
        assert updates[-1].fresh is not None


@few
@given(periods, st.one_of(st.just(0.0), offsets), st.floats(0.0, 5.0))
def test_frames_that_stop_changing_are_silent_as_before(period, offset, seconds):
    link = Link()
    link.frames(100, period, offset)
    stamp = link.stream._last_stamp + link.clock.value
    began = link.now
    while link.now - began < seconds:
        assert link.step(0.01, stamp).fresh is None
    assert link.stream.silence == pytest.approx(link.now - began)
    assert link.stream.runs == (link.stream._pause <= max(PAUSE_S, 2.5 * period))


@few
@given(offsets, st.sampled_from((-1e-4, -5e-5, 5e-5, 1e-4)))
def test_an_offset_that_drifts_is_followed(offset, drift):
    link = Link()
    link.frames(50, 0.02, offset)
    for i in range(800):
        t = 15.0 * i
        assert abs(link.clock.value - (offset + drift * t)) < MAX_SKEW_S
        link.clock.take(CLOCK + link.now + t + offset + drift * t, CLOCK + link.now + t, link.now + t)
    assert link.clock.number == 1


@few
@given(periods, st.floats(1.01, 1e5).map(lambda x: x * MAX_OFFSET_S))
def test_a_recording_is_never_taken_for_a_clock(period, age):
    link = Link()
    updates = link.frames(100, period, -age)
    assert all(update.fresh is None for update in updates) and link.clock.number == 0
