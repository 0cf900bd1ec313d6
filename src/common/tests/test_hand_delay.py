"""The delay of one motion behind another: found where there is motion, None where not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.hand_delay import NEWEST_S, PERIOD_S, DelayMeter, Track, hand_delay
from common.rotations import rotation_from_zyx

seeds = st.integers(0, 2**32 - 1)


def motion(seed):
    """A smooth motion of several centimetres as a function of time: of times, shape (n,) [s], shape (n, 3) [m]."""
    random = np.random.default_rng(seed)
    hertz, phase = random.uniform(0.1, 1.2, (6, 3)), random.uniform(0.0, 2.0 * np.pi, (6, 3))
    size = random.uniform(0.3, 1.0, (6, 3)) * 0.02 / hertz
    return lambda t: (size * np.sin(2.0 * np.pi * hertz * t[:, None, None] + phase)).sum(axis=1)


def track(times, positions):
    result = Track()
    for time, position in zip(times.tolist(), positions.tolist()):
        result.add(time, position)
    return result


def times(rate, seconds, seed):
    random = np.random.default_rng(seed)
    return 1.6e9 + np.arange(0.0, seconds, 1.0 / rate) + random.uniform(0.0, 0.5 / rate, round(seconds * rate))


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(0.0, 0.4), st.floats(0.3, 2.0), st.sampled_from([60.0, 110.0]), st.sampled_from([40.0, 100.0]))
def test_a_known_delay_is_found_within_2_ms(seed, delay, scale, palm_rate, tool_rate):
    """Whatever the orientation and the scaling between the two frames, with noise of the tracker and uneven samples."""
    random = np.random.default_rng(seed)
    move, R = motion(seed), rotation_from_zyx(*random.uniform(-3.0, 3.0, 3))
    t, u = times(palm_rate, 20.0, seed), times(tool_rate, 20.0, seed + 1)
    palms = move(t - 1.6e9) + random.normal(0.0, 1e-4, (len(t), 3))
    tools = scale * move(u - 1.6e9 - delay) @ R.T + random.normal(size=3)
    found = hand_delay(track(t, palms), track(u, tools))
    assert found.median == pytest.approx(delay, abs=0.002)
    assert found.low <= found.median <= found.high and found.windows >= 5


@settings(max_examples=10, deadline=None)
@given(seeds, st.floats(0.0, 2e-4))
def test_without_motion_there_is_no_number(seed, noise):
    random = np.random.default_rng(seed)
    t = times(100.0, 15.0, seed)
    still = track(t, random.normal(0.0, noise, (len(t), 3)))
    moving = track(t, motion(seed)(t - 1.6e9))
    for palm, tool in ((still, still), (moving, still), (still, moving), (Track(), moving), (moving, Track())):
        assert hand_delay(palm, tool) is None


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_two_motions_that_have_nothing_to_do_with_each_other_have_no_delay(seed):
    t = times(100.0, 15.0, seed)
    assert hand_delay(track(t, motion(seed)(t - 1.6e9)), track(t, motion(seed + 1)(t - 1.6e9))) is None


def test_gaps_and_a_tool_that_stays_at_a_bound_leave_windows_out():
    move, t = motion(5), times(100.0, 40.0, 5)
    tools = move(t - 1.6e9 - 0.06)
    tools[t < 1.6e9 + 15.0] = tools[0]
    keep = (t < 1.6e9 + 20.0) | (t > 1.6e9 + 20.5)
    whole = hand_delay(track(t, move(t - 1.6e9)), track(t, tools))
    part = hand_delay(track(t[keep], move(t - 1.6e9)[keep]), track(t[keep], tools[keep]))
    assert whole.median == pytest.approx(0.06, abs=0.002) and part.median == pytest.approx(0.06, abs=0.002)
    assert part.windows < whole.windows < 24


def test_samples_that_come_twice_late_or_without_a_number_are_left_out():
    palm = Track()
    for time in (1.0, 1.0, 0.5, 2.0, np.nan, np.inf):
        palm.add(time, (time, 0.0, 0.0))
    palm.add(3.0, (np.nan, 0.0, 0.0))
    assert list(palm.samples) == [(1.0, 1.0, 0.0, 0.0), (2.0, 2.0, 0.0, 0.0)]


def test_a_track_keeps_the_newest_seconds_and_begins_anew_when_the_clock_is_set():
    palm = Track(kept=5.0)
    for time in range(20):
        palm.add(float(time), (0.0, 0.0, 0.0))
    assert [sample[0] for sample in palm.samples] == [14.0, 15.0, 16.0, 17.0, 18.0, 19.0]
    palm.add(1e10, (0.0, 0.0, 0.0))
    palm.add(20.0, (0.0, 0.0, 0.0))
    assert [sample[0] for sample in palm.samples] == [20.0]


@settings(max_examples=3, deadline=None)
@given(seeds, st.floats(0.0, 0.3))
def test_a_live_delay_is_that_of_the_last_seconds_and_ends_with_the_motion(seed, delay):
    """Before 30 s the delay is another one; after 60 s the palm is no longer followed."""
    meter, shown, now = DelayMeter(), [], np.arange(0.0, 80.0, 0.01)
    palms = motion(seed)(now)
    tools = motion(seed)(now - np.where(now > 30.0, delay, 0.45))
    for i, (time, palm, tool) in enumerate(zip(now.tolist(), palms.tolist(), tools.tolist())):
        if time < 60.0:
            meter.palm.add(time, palm)
        meter.tool.add(time, tool)
        if i % 50 == 0:
            shown.append((time, meter.at(time)))
    assert max(len(meter.palm.samples), len(meter.tool.samples)) <= 100 * NEWEST_S + 2
    for time, found in shown:
        if time < 3.0 or time > 60.0 + NEWEST_S:
            assert found is None
        elif 30.0 + NEWEST_S + PERIOD_S < time < 60.0:
            assert found.median == pytest.approx(delay, abs=0.002)
    assert len({id(found) for _, found in shown}) <= 1 + 80.0 / PERIOD_S


def test_a_clock_that_is_set_back_ends_a_live_delay_at_once():
    meter, now = DelayMeter(), np.arange(0.0, 11.0, 0.01)
    for time, palm, tool in zip(now.tolist(), motion(3)(now).tolist(), motion(3)(now - 0.1).tolist()):
        meter.palm.add(time, palm)
        meter.tool.add(time, tool)
    assert meter.at(11.0).median == pytest.approx(0.1, abs=0.002)
    assert meter.at(-50.0) is None
