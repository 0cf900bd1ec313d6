"""Limits of the stream of servo goals: nothing is faster than allowed, nothing allowed is held back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import parse
from kuka_control.limits.motion_limits import ARM_S, LEAD_RAD, MotionLimits, Unlimited
from kuka_control.limits.moving_arm import ShapeLimits
from kuka_control.limits.speed_change import GuardedRoom
from kuka_control.loop.assembly import motion_limits
from kuka_control.loop.goal_stream import TOLERANCE_RAD, is_jump
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.rig import Rig
from kuka_control.numbers import GAP_S, LOST_S

SPEEDS = np.radians([98.0, 98.0, 100.0, 130.0, 140.0, 180.0, 180.0])
ACCELERATION = 12.0 * SPEEDS / SPEEDS[0]
JERK = 1000.0 * SPEEDS / SPEEDS[0]
TCP_SPEED = 0.7
RANGE = np.full(7, 2.2)
REST = np.zeros(7)
WRIST = np.array([0, 0, 0, 0, 0, 0, 1.0])
DT = 0.004

joints = st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7).map(np.array)
cycles = st.lists(st.floats(1e-4, 0.05), min_size=1, max_size=40)


def tool_position(q):
    """A planar chain: what matters is that the tool moves along curves."""
    turns = np.cumsum(q[:3])
    return np.array([0.4 * np.cos(turns).sum(), 0.4 * np.sin(turns).sum(), 0.1 * q[3]])


class PlanarArm:
    """The tool is the only point; the fourth joint moves it by 0.1 m/rad along the axes."""

    def tool_point(self, q):
        turns = np.cumsum(q[:3])
        joints = [0.4 * np.array([np.cos(turns[:i]).sum(), np.sin(turns[:i]).sum()]) for i in range(4)]
        reaches = [float(np.linalg.norm(joints[3] - axis)) for axis in joints[:3]] + [0.1, 0.0, 0.0, 0.0]
        return tool_position(q), reaches

    def speed(self, q, v):
        q, step = np.array(q), 1e-6 * np.array(v)
        return float(np.linalg.norm(tool_position(q + step) - tool_position(q - step)) / 2e-6)


def limits(start=REST):
    room = GuardedRoom(-RANGE, RANGE, TCP_SPEED, PlanarArm())
    result = MotionLimits(SPEEDS, ShapeLimits(ACCELERATION, JERK), room)
    result.reset(start)
    return result


def run(follower, target, seconds, dt=DT, share=1.0):
    """Returns the goals, shape (n, 7), of an arm that is where it is sent; `target` is (q, v) at a time."""
    goals = [follower.goal]
    for i in range(round(seconds / dt)):
        q, v = target((i + 1) * dt) if callable(target) else (target, REST)
        goals.append(follower.step(q, follower.goal, dt, share, v).q)
    return np.array(goals)


def speeds(goals, dt=DT):
    return np.diff(goals, axis=0) / dt


@settings(max_examples=25)
@given(joints, st.lists(st.tuples(joints, st.integers(1, 60)), min_size=1, max_size=5))
def test_speed_acceleration_and_jerk_keep_their_limits_whatever_the_targets(start, targets):
    follower = limits(start)
    goals = np.concatenate([run(follower, target, n * DT) for target, n in targets])
    goals = goals[np.concatenate([[True], np.any(np.diff(goals, axis=0) != 0.0, axis=1)])]
    v = speeds(goals)
    assert np.all(np.abs(v) <= 1.01 * SPEEDS)
    assert np.all(np.abs(np.diff(v, axis=0)) / DT <= 1.01 * ACCELERATION)
    assert np.all(np.abs(np.diff(v, n=2, axis=0)) / DT**2 <= 1.05 * JERK + 1.0)


@pytest.mark.parametrize(
    ("key", "value", "derivative"),
    [("joint_speed", 0.4, 1), ("joint_acceleration", 5.0, 2), ("joint_acceleration", 12.0, 2), ("joint_jerk", 60.0, 3)],
)
def test_the_stream_of_a_controller_reaches_and_keeps_the_limits_of_its_parameters(key, value, derivative):
    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "kuka_params_rt.yaml").read_text())
    config = parse(RealTimeConfig, {**values, "tcp_speed": 0.79, key: value}, "kuka/")
    rig = Rig.of(config)
    follower = motion_limits(config, rig)
    follower.reset(rig.home.q)
    goals = run(follower, rig.home.q + np.eye(7)[6] * 1.5, 1.5)  # joint 7 turns the tool where it is
    full = rig.model.max_speed[6]
    limit = value * (full if key == "joint_speed" else full / rig.model.max_speed.min())
    reached = np.max(np.abs(np.diff(goals[:, 6], n=derivative))) / DT**derivative
    assert reached == pytest.approx(limit, rel=0.05)


@settings(max_examples=12)
@given(joints, joints)
def test_the_tool_keeps_its_speed_limit(start, target):
    tool = np.array([tool_position(q) for q in run(limits(start), target, 1.0)])
    # A speed is chosen for the pose it starts from; while it is approached the tool moves on along its curve.
    assert np.max(np.linalg.norm(np.diff(tool, axis=0), axis=1)) <= 1.05 * TCP_SPEED * DT


@settings(max_examples=8)
@given(joints, joints)
def test_the_target_is_reached_without_overshoot_and_stood_on(start, target):
    follower = limits(start)
    goals = run(follower, target, 8.0)
    assert np.all(goals >= np.minimum(start, target) - 3e-4) and np.all(goals <= np.maximum(start, target) + 3e-4)
    step = follower.step(target, target, DT)
    np.testing.assert_array_equal(step.q, target)
    np.testing.assert_array_equal(step.v, REST)
    assert step.limited_by is None


@given(cycles)
def test_uneven_cycles_move_the_goal_by_their_time_and_a_gap_puts_it_at_rest(dts):
    """Reported in https://github.com/IFL-CAMP/iiwa_stack/issues/284: jerky at low speeds. Tried: uneven cycles."""
    follower = limits()
    before, v, after_gap = REST, REST, False
    for dt in dts:
        step = follower.step(2.0 * WRIST, before, dt)
        after_gap, twice = dt > GAP_S, after_gap and dt > GAP_S
        if twice:  # a slow link or machine: it moves on from rest
            assert np.all(np.abs(step.q - before) <= JERK * GAP_S**3 / 6.0 + 1e-9)
        elif dt > GAP_S:
            np.testing.assert_array_equal(step.q, before)
            np.testing.assert_array_equal(step.v, REST)
        else:
            assert np.all(np.abs(step.q - before) <= SPEEDS * dt + 1e-9)
            assert np.all(np.abs(step.v - v) <= ACCELERATION * dt + 1e-9)
        before, v = step.q, step.v


@settings(max_examples=20)
@given(st.floats(-0.6, 0.6), st.floats(0.002, 0.006))
def test_a_steady_target_within_the_limits_is_met_without_lag(share, dt):
    v = share * SPEEDS * WRIST
    follower = limits()
    for i in range(-170, 171):
        step = follower.step(v * i * dt, follower.goal, dt, 1.0, v)
    assert step.limited_by is None
    np.testing.assert_allclose(step.q, v * i * dt, atol=1e-5)


def test_the_result_names_the_limit():
    def named(target, measured=None):
        follower = limits()
        return {
            follower.step(target, follower.goal if measured is None else measured, DT).limited_by for _ in range(60)
        }

    assert "joint speed" in named(2.0 * WRIST)
    assert "arm speed" in named(np.array([1.0, 0, 0, 0, 0, 0, 0]))
    assert "lag of the arm" in named(2.0 * WRIST, REST)
    assert "joint acceleration" in named(0.05 * WRIST)


@pytest.mark.parametrize(("dt", "rests"), [(0.012, False), (GAP_S, False), (0.031, True), (0.05, True), (1.0, True)])
def test_after_a_gap_the_goal_starts_from_rest(dt, rests):
    """The arm has come to rest at the last goal meanwhile, so a goal that went on at full speed would tear at it."""
    follower = limits()
    run(follower, 2.0 * WRIST, 0.4)
    before = follower.goal
    after = follower.step(2.0 * WRIST, before, dt)
    if not rests:
        assert after.q[6] - before[6] == pytest.approx(SPEEDS[6] * dt, rel=0.02)
        return
    np.testing.assert_array_equal(after.q, before)
    assert after.limited_by == "gap between goals"
    goals = np.concatenate([[before], run(follower, 2.0 * WRIST, 0.2)])
    assert np.max(np.abs(np.diff(goals, n=2, axis=0))) / DT**2 <= 1.01 * ACCELERATION[6]
    assert np.max(speeds(goals)) == pytest.approx(SPEEDS[6], rel=0.01)


@settings(max_examples=10)
@given(joints)
def test_the_goal_waits_for_an_arm_that_stands(target):
    follower = limits()
    for _ in range(300):
        step = follower.step(target, REST, DT)
    # What an arm at full speed may be behind, and the way in which the goal brakes.
    assert np.all(np.abs(step.q) <= LEAD_RAD[1] + ARM_S * SPEEDS + SPEEDS**2 / (2.0 * ACCELERATION) + 0.05)


def test_a_goal_that_comes_back_to_the_arm_is_not_held():
    follower = limits(WRIST)
    run_back = [follower.step(REST, REST, DT) for _ in range(50)]
    assert all(step.limited_by != "lag of the arm" for step in run_back)
    assert run_back[-1].q[6] < 0.9


def test_a_share_of_the_limits():
    v = speeds(run(limits(), 2.0 * WRIST, 1.0, share=0.5))
    assert np.max(v[:, 6]) == pytest.approx(0.5 * SPEEDS[6])


@settings(max_examples=12)
@given(st.lists(st.tuples(joints, st.floats(-3.0, 3.0), st.integers(1, 60)), min_size=1, max_size=6))
def test_no_goal_leaves_the_joint_ranges_also_when_the_target_rushes_at_them(targets):
    follower = limits()
    goals = np.concatenate([
        run(follower, lambda t, q=q, v=v: (np.clip(1.1 * q + v * t, -RANGE, RANGE), np.full(7, v)), n * DT)
        for q, v, n in targets
    ])  # fmt: skip
    assert np.all(np.abs(goals) <= RANGE)
    v = speeds(goals[np.concatenate([[True], np.any(np.diff(goals, axis=0) != 0.0, axis=1)])])
    assert np.all(np.abs(np.diff(v, axis=0)) / DT <= 1.01 * ACCELERATION)


def test_without_limits_every_target_is_the_goal():
    follower = Unlimited()
    follower.reset(REST)
    step = follower.step(2.0 * WRIST, REST, DT)
    np.testing.assert_array_equal(step.q, 2.0 * WRIST)
    assert step.limited_by is None


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
