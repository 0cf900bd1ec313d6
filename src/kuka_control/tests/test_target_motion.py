"""Targets between the frames: they go on as they did, and not for long."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kuka_control.loop.goal_stream import TargetMotion
from kuka_control.numbers import CONTINUED_S, FADE_S

UPPER = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
SKEW = 1.7e9


def motion():
    return TargetMotion(-UPPER, UPPER, np.zeros(7))


def feed(follower, q_of, rate, seconds, late=lambda i: 0.0):
    """Frames of a joint that is a function of time; returns the time of the last one."""
    for i in range(round(seconds * rate)):
        follower.take(np.full(7, q_of(i / rate)), SKEW + i / rate, i / rate + late(i))
    return i / rate


@given(st.floats(-1.5, 1.5), st.sampled_from([74.0, 100.0, 115.0]), st.floats(0.0, 0.015))
def test_a_steady_target_continues_between_frames(speed, rate, age):
    follower = motion()
    last = feed(follower, lambda t: speed * t, rate, 0.5)
    at = follower.at(last + min(age, 1.0 / rate))
    np.testing.assert_allclose(at.q, speed * (last + min(age, 1.0 / rate)), atol=1e-6)
    np.testing.assert_allclose(at.v, speed, atol=1e-4)


@given(st.floats(-1.5, 1.5), st.floats(0.0, 5.0))
def test_it_does_not_run_on_when_frames_stop(speed, age):
    follower = motion()
    last = feed(follower, lambda t: speed * t, 74.0, 0.5)
    at = follower.at(last + age)
    assert np.all(np.abs(at.q - speed * last) <= abs(speed) * (CONTINUED_S + 0.5 * FADE_S) + 1e-9)
    if age > CONTINUED_S + FADE_S:
        np.testing.assert_allclose(at.v, 0.0, atol=1e-12)


def test_frames_that_come_late_are_taken_for_what_they_are():
    random = np.random.default_rng(1)
    follower = motion()
    late = [0.0, *random.uniform(0.0, 0.012, 40)]
    for i in range(41):
        now = i / 74.0 + late[i]
        follower.take(np.full(7, 0.5 * i / 74.0), SKEW + i / 74.0, now)
        np.testing.assert_allclose(follower.at(now).q, 0.5 * now if i else 0.0, atol=1e-6)


def test_a_trembling_target_has_no_speed():
    follower = motion()
    feed(follower, lambda t: 1e-3 * (-1.0) ** round(74.0 * t), 74.0, 0.5)
    np.testing.assert_array_equal(follower.at(1.0).v, np.zeros(7))


def test_a_target_that_stops_is_carried_on_by_no_more_than_a_frame():
    follower = motion()
    furthest = 0.0
    for i in range(60):
        stamp = i / 74.0
        follower.take(np.full(7, min(stamp, 0.4)), SKEW + stamp, stamp)
        furthest = max(furthest, *(follower.at(stamp + part / 74.0).q[0] for part in (0.0, 0.5, 1.0)))
    assert furthest <= 0.4 + 1.0 / 74.0
    np.testing.assert_array_equal(follower.at(stamp + 0.01).q, np.full(7, 0.4))


def test_held_and_after_a_gap_it_rests():
    follower = motion()
    last = feed(follower, lambda t: t, 74.0, 0.3)
    follower.hold()
    np.testing.assert_array_equal(follower.at(last + 0.01).v, np.zeros(7))
    np.testing.assert_allclose(follower.at(last + 0.01).q, last)
    follower.take(np.full(7, 0.5), SKEW + 3.0, 3.0)
    np.testing.assert_array_equal(follower.at(3.01).q, np.full(7, 0.5))


def test_no_continuation_leaves_the_joint_ranges():
    follower = motion()
    last = feed(follower, lambda t: UPPER[1] - 0.301 + t, 74.0, 0.3)
    at = follower.at(last + 0.03)
    assert np.all(at.q <= UPPER) and at.v[1] == 0.0 and at.v[0] > 0.0


@pytest.mark.parametrize("stamp", [SKEW - 1.0, SKEW])
def test_a_clock_that_was_set_back_starts_anew(stamp):
    follower = motion()
    last = feed(follower, lambda t: t, 74.0, 0.3)
    follower.take(np.full(7, 0.2), stamp, last + 0.01)
    np.testing.assert_array_equal(follower.at(last + 0.015).q, np.full(7, 0.2))
