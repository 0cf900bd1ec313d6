"""Steps, duration and tool speed of a motion before it starts."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from common.poses import translation
from iiwa_kinematics import forward
from iiwa_kinematics.robot_model import robot_model
from kuka_control.model.joint_configurations import ARRIVED_DEG, JointMotion

MODEL = robot_model("LBR7R800", "MF_elektrisch")
TOOL = translation(0.0, 0.0, 0.106)
joints = arrays(float, 7, elements=st.floats(-2.0, 2.0))
ZERO, BENT = np.zeros(7), np.radians([0.0, 20.0, 10.0, -110.0, 0.0, 90.0, -45.0])


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
