"""Laws of one motion's progress."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common.poses import translation
from iiwa_kinematics import forward
from iiwa_kinematics.robot_model import robot_model
from kuka_control.limits.joint_motion import ARRIVED_DEG, GIVEN_UP_S, STALLED_S, JointMotion, MotionWatch

MODEL = robot_model("LBR7R800", "MF_elektrisch")
TOOL = translation(0.0, 0.0, 0.106)
joints = arrays(float, 7, elements=st.floats(-2.0, 2.0))
ZERO, BENT = np.zeros(7), np.radians([0.0, 20.0, 10.0, -110.0, 0.0, 90.0, -45.0])


@given(joints, joints, st.floats(0.0, 1.0))
def test_on_the_straight_way_the_share_is_the_part_of_the_way(start, target, part):
    motion = JointMotion(start, target)
    assume(motion.needed)
    progress = MotionWatch(motion, 0.0).step(start + part * (target - start), 1.0)
    assert progress.share == pytest.approx(part, abs=1e-6)
    assert progress.remaining == pytest.approx((1.0 - part) * abs(motion.largest[1]), abs=1e-6)


@given(joints, joints, joints)
def test_whatever_the_joints_the_share_is_a_share_and_the_bar_has_its_width(start, target, q):
    progress = MotionWatch(JointMotion(start, target), 0.0).step(q, 1.0)
    assert 0.0 <= progress.share <= 1.0 and progress.remaining >= 0.0
    assert progress.bar(20).index("]") == 21


def test_the_largest_step_has_joint_and_sign():
    assert JointMotion(ZERO, BENT).largest == (4, pytest.approx(-110.0))
    assert JointMotion(BENT, ZERO).largest == (4, pytest.approx(110.0))


def test_where_the_arm_is_already_no_motion_is_needed():
    assert not JointMotion(BENT, BENT + np.radians(0.9 * ARRIVED_DEG)).needed
    assert JointMotion(BENT, BENT + np.radians(1.1 * ARRIVED_DEG)).needed


def test_the_slowest_joint_decides_how_long_it_takes():
    speeds = np.radians([10.0, 10.0, 10.0, 10.0, 10.0, 5.0, 10.0])
    assert JointMotion(ZERO, BENT).least_duration(speeds) == pytest.approx(18.0)


@given(joints, joints, st.floats(0.01, 1.0))
def test_the_tool_is_as_fast_as_finite_differences_say(start, target, velocity):
    motion = JointMotion(start, target)
    assume(motion.needed)
    duration = motion.least_duration(velocity * MODEL.max_speed)
    parts = np.linspace(0.0, 1.0, 401)
    way = [(forward(MODEL, start + part * (target - start)) @ TOOL)[:3, 3] for part in parts]
    expected = np.linalg.norm(np.diff(way, axis=0), axis=1).max() * 400.0 / duration
    assert motion.greatest_tool_speed(MODEL, TOOL, velocity) == pytest.approx(expected, rel=0.02)


def test_no_motion_has_no_speed():
    assert JointMotion(BENT, BENT).greatest_tool_speed(MODEL, TOOL, 0.5) == 0.0


def test_the_table_has_no_minus_zero():
    lines = JointMotion(-1e-9 * np.ones(7), BENT).table()
    assert len(lines) == 8
    assert lines[1].split() == ["1", "0.0", "0.0", "+0.0"]
    assert lines[4].split() == ["4", "0.0", "-110.0", "-110.0"]


def test_an_arm_that_stands_still_is_noticed_and_forgiven_when_it_goes_on():
    watch = MotionWatch(JointMotion(ZERO, BENT), 0.0)
    assert not watch.step(ZERO, 0.5 * STALLED_S).stalled
    assert watch.step(ZERO, STALLED_S).stalled
    assert not watch.step(0.1 * BENT, STALLED_S + 0.1).stalled
    still = watch.step(0.1 * BENT, STALLED_S + 0.1 + GIVEN_UP_S)
    assert still.stalled and still.given_up


def test_slow_motion_is_motion():
    watch = MotionWatch(JointMotion(ZERO, BENT), 0.0)
    assert not any(watch.step(t * 1e-4 * BENT, t).stalled for t in np.arange(0.0, 60.0, 0.1))
