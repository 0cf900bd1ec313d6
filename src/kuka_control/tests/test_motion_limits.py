"""Limits of the stream of servo goals: nothing is faster than allowed, nothing allowed is held back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kuka_control.jump import LOST_S, TOLERANCE_RAD, is_jump
from kuka_control.motion_limits import CARRIED_S, LEAD_RAD, SAVED_S, MotionLimits, SpeedLimits

SPEEDS = np.radians([98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0])
TCP_SPEED = 0.75
REST = np.zeros(7)

joints = st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7).map(np.array)
cycles = st.lists(st.floats(1e-4, 0.05), min_size=1, max_size=30)


def tool_position(q):
    """A planar chain: what matters is that the tool moves along curves."""
    turns = np.cumsum(q[:3])
    return np.array([0.4 * np.cos(turns).sum(), 0.4 * np.sin(turns).sum(), 0.1 * q[3]])


def limits(start=None):
    result = MotionLimits(SpeedLimits(SPEEDS, TCP_SPEED), tool_position)
    result.reset(np.zeros(7) if start is None else start)
    return result


@given(joints, joints, cycles)
def test_goals_are_never_faster_than_the_limits_and_reach_the_target(start, target, dts):
    follower = limits(start)
    before = start
    for dt in dts:
        q = follower.step(target, before, dt).q
        time = min(dt, SAVED_S) + 1e-9
        assert np.all(np.abs(q - before) <= SPEEDS * time)
        # The way of the tool along the chord of a small step may be off by the curvature of its path.
        assert np.linalg.norm(tool_position(q) - tool_position(before)) <= 1.02 * TCP_SPEED * time
        before = q
    for _ in range(2000):
        step = follower.step(target, follower.goal, SAVED_S)
    np.testing.assert_array_equal(step.q, target)
    assert step.limited_by is None


@given(joints, joints)
def test_a_step_stays_between_start_and_target(start, target):
    q = limits(start).step(target, start, 0.004).q
    assert np.all(q >= np.minimum(start, target) - 1e-12) and np.all(q <= np.maximum(start, target) + 1e-12)


@given(st.floats(0.01, 0.95), st.lists(st.floats(0.002, 0.009), min_size=5, max_size=40))
def test_a_target_within_the_limits_is_the_goal_at_once(share, dts):
    follower = limits()
    follower.step(np.zeros(7), np.zeros(7), SAVED_S)
    q = np.zeros(7)
    for dt in dts:
        q = q + np.array([0, 0, 0, 1.0, 0, 0, 1.0]) * share * SPEEDS * dt
        step = follower.step(q, q, dt)
        assert step.limited_by is None
        np.testing.assert_array_equal(step.q, q)


def test_ticks_between_targets_do_not_use_up_the_time():
    """Targets every 9 ms at 90 % of the speed, goals every 3 ms: none is held back."""
    follower = limits()
    q = np.zeros(7)
    follower.step(q, q, SAVED_S)
    for _ in range(50):
        q = q + np.array([0, 0, 0, 0, 0, 0, 0.9 * SPEEDS[6] * 0.009])
        for _ in range(3):
            step = follower.step(q, q, 0.003)
            assert step.limited_by is None
            np.testing.assert_array_equal(step.q, q)


def test_slow_moments_do_not_pay_for_fast_ones():
    follower = limits()
    q = np.zeros(7)
    for _ in range(100):
        q = q + np.array([0, 0, 0, 0, 0, 0, 0.1 * SPEEDS[6] * 0.004])
        follower.step(q, q, 0.004)
    start = q[6]
    for i in range(1, 51):
        q = q + np.array([0, 0, 0, 0, 0, 0, 1.2 * SPEEDS[6] * 0.004])
        goal = follower.step(q, q, 0.004).q[6]
        assert goal - start <= SPEEDS[6] * (i * 0.004 + CARRIED_S) + 1e-9


def test_the_result_names_the_limit():
    wrist = np.array([0, 0, 0, 0, 0, 0, 1.0])
    assert limits().step(wrist, REST, 0.004).limited_by == "joint speed"
    shoulder = np.array([0.5, 0, 0, 0, 0, 0, 0])
    assert limits().step(shoulder, REST, 0.004).limited_by == "tool speed"


def test_a_stall_of_the_loop_is_not_made_up_for():
    q = limits().step(np.array([0, 0, 0, 0, 0, 0, 2.0]), REST, 1.0).q
    assert q[6] == pytest.approx(SPEEDS[6] * SAVED_S)


@given(joints, st.lists(st.floats(0.001, 0.05), min_size=1, max_size=60))
def test_the_goal_waits_for_an_arm_that_stands(target, dts):
    follower = limits()
    for dt in dts:
        step = follower.step(target, REST, dt)
        assert np.all(np.abs(step.q) <= LEAD_RAD + 1e-12)
    if np.array_equal(step.q, target):
        assert step.limited_by is None


def test_a_goal_that_comes_back_to_the_arm_is_not_held():
    follower = limits(np.full(7, 1.0))
    step = follower.step(np.full(7, 1.0 - 1e-4), REST, 0.01)
    np.testing.assert_array_equal(step.q, np.full(7, 1.0 - 1e-4))


def test_a_share_of_the_limits():
    target = np.array([0, 0, 0, 0, 0, 0, 2.0])
    assert limits().step(target, REST, 0.004, 0.5).q[6] == pytest.approx(0.5 * SPEEDS[6] * 0.004)


@given(joints, st.floats(0.0, LOST_S), st.integers(0, 6), st.sampled_from([-1.0, 1.0]))
def test_a_jump_is_more_than_two_degrees_beyond_the_speed_limit(q, dt, joint, sign):
    allowed = TOLERANCE_RAD + SPEEDS[joint] * dt
    step = np.zeros(7)
    step[joint] = sign
    assert not is_jump(q, q + 0.999 * allowed * step, dt, SPEEDS)
    assert is_jump(q, q + 1.001 * allowed * step, dt, SPEEDS)


def test_a_gap_in_time_allows_no_more_than_a_cycle():
    step = np.array([np.radians(5.0), 0, 0, 0, 0, 0, 0])
    assert is_jump(np.zeros(7), step, 3.0, SPEEDS)
    assert not is_jump(np.zeros(7), step, 0.09, SPEEDS)
