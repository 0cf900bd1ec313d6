"""Laws of the simulated arm's motions: profiles, the servo's law and drives, kinematics from the URDF."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.poses import pose
from common.rotations import rotation_from_zyx
from rig_simulation.devices.sunrise.arm import FULL_SPEED_TIME_S, MOTION_FRACTION
from rig_simulation.devices.sunrise.paths import JointMove, SmoothStep
from rig_simulation.devices.sunrise.robot import Drives, Robot, lts_law, plain_law
from rig_simulation.files import read_urdf

ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))
FULL_ACCELERATION = ROBOT.max_speed / FULL_SPEED_TIME_S
ACCELERATION = MOTION_FRACTION * FULL_ACCELERATION
HOME = np.array([-0.7854, 0.5236, 0.0, -1.39626, 0.0, 1.22173, 0.0])
TOOL = pose(p=(0.0, 0.0, 0.106))
positive = st.floats(1e-3, 1e3)
joints = st.builds(
    lambda shares: ROBOT.lower + np.array(shares) * (ROBOT.upper - ROBOT.lower),
    st.lists(st.floats(0.0, 1.0), min_size=7, max_size=7),
)


@given(positive, positive)
def test_a_step_keeps_its_limits_and_is_symmetric(speed, acceleration):
    step = SmoothStep(speed, acceleration)
    t = np.linspace(0.0, step.duration, 2001)
    s = np.array([step.at(x) for x in t])
    v = np.diff(s) / t[1]
    assert s[0] == 0.0
    assert s[-1] == 1.0
    assert step.at(-1.0) == 0.0
    assert v.min() >= -1e-9
    assert v.max() <= speed * (1.0 + 1e-6)
    assert np.abs(np.diff(v) / t[1]).max() <= acceleration * (1.0 + 1e-3)
    assert_allclose(s + s[::-1], 1.0, atol=1e-9)


speeds = st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7).map(np.array)
errors = st.lists(st.floats(-0.3, 0.3) | st.floats(-1e-9, 1e-9), min_size=7, max_size=7).map(np.array)


@given(errors, speeds)
def test_law_and_drives_compute_their_formulas_and_leave_their_input(error, v):
    """As written in the docstrings: f(e) = sign(e) a (1 - exp(-(e/b)^2)); mid-point speed, braking, limits."""
    given_error, given_v = error.copy(), v.copy()
    distance = lts_law(error)
    assert_allclose(distance, np.copysign(0.07 * (1.0 - np.exp(-((error / 0.0525) ** 2))), error), rtol=0.0, atol=1e-15)
    lag, braking, path = 2.0 / 3.0 * 0.04, 0.8 * FULL_ACCELERATION, np.abs(distance)
    close = path <= braking * lag**2
    speed = np.where(close, path / lag, np.sqrt(np.maximum(0.0, 2.0 * braking * path - (braking * lag) ** 2)))
    change = np.copysign(np.minimum(speed, ROBOT.max_speed), distance) - v
    most = FULL_ACCELERATION * 1e-3
    after = Drives(ROBOT.max_speed, FULL_ACCELERATION, 0.04).towards(distance, v, 1e-3)
    assert_allclose(after, v + np.clip(change, -most, most), atol=1e-12)
    assert np.array_equal(error, given_error) and np.array_equal(v, given_v)


@settings(max_examples=25)
@given(joints, joints, st.floats(0.01, 1.0))
def test_a_joint_move_arrives_exactly_with_all_joints_in_step(start, end, share):
    if np.array_equal(start, end):
        return
    move = JointMove(start, end, share * ROBOT.max_speed, ACCELERATION)
    t = np.linspace(0.0, move.duration, 501)
    q = np.array([move.at(x) for x in t])
    assert np.array_equal(q[0], start)
    assert np.array_equal(q[-1], end)
    assert np.all(np.abs(np.diff(q, axis=0)) <= share * ROBOT.max_speed * t[1] * (1 + 1e-6) + 1e-12)
    moved = np.abs(end - start) > 1e-3
    if moved.any():
        shares = (q[:, moved] - start[moved]) / (end - start)[moved]
        assert_allclose(shares, shares[:, :1] @ np.ones((1, shares.shape[1])), atol=1e-9)


def test_the_slowest_joint_uses_its_full_share():
    move = JointMove(np.zeros(7), HOME, 0.25 * ROBOT.max_speed, ACCELERATION)
    v = np.array([move.at(t + 1e-3) - move.at(t) for t in np.arange(0.0, move.duration, 1e-3)]) / 1e-3
    assert_allclose(np.max(np.abs(v) / ROBOT.max_speed), 0.25, rtol=1e-6)


@pytest.mark.parametrize("law", [lts_law, plain_law])
@pytest.mark.parametrize("step", [1e-3, 0.05, 0.5, 2.0])
def test_the_servo_reaches_a_step_without_overshoot_within_its_limits(law, step):
    drives = Drives(ROBOT.max_speed, FULL_ACCELERATION, 0.04)
    goal, q, v, dt = step * np.array([1, -1, 1, -1, 1, -1, 1.0]), np.zeros(7), np.zeros(7), 1e-3
    for _ in range(6000):
        v_next = drives.towards(law(goal - q), v, dt)
        assert np.all(np.abs(v_next) <= ROBOT.max_speed)
        assert np.all(np.abs(v_next - v) <= FULL_ACCELERATION * dt * (1 + 1e-9))
        q, v = q + v_next * dt, v_next
        assert np.all(np.abs(q) <= step + 1e-4)
    assert_allclose(q, goal, atol=4e-4)


def test_the_flange_is_where_the_toolbox_has_it():
    q = np.radians([10.0, 20.0, 30.0, -40.0, 50.0, 60.0, 70.0])
    T = Robot(read_urdf("LBR7R800", "MF_touch_pneumatisch")).flange(q)
    assert_allclose(1000 * T[:3, 3], [447.1375, 389.4789, 911.8808], atol=6e-5)
    assert_allclose(T[:3, :3], rotation_from_zyx(2.958711, -0.495729, 1.666864), atol=2e-6)


@settings(max_examples=50)
@given(joints)
def test_the_jacobian_is_the_derivative_of_the_pose(q):
    v, h = np.linspace(-1.0, 1.0, 7), 1e-6
    T = ROBOT.flange(q) @ TOOL
    ahead, behind = ROBOT.flange(q + h * v) @ TOOL, ROBOT.flange(q - h * v) @ TOOL
    p_dot = (ahead - behind)[:3, 3] / (2 * h)
    twist = ROBOT.jacobian(q, TOOL) @ v
    assert_allclose(T[:3, :3] @ twist[:3], p_dot, atol=1e-6)
    assert_allclose(ROBOT.tool_speed(q, v, TOOL), np.linalg.norm(p_dot), atol=1e-6)


def test_a_description_without_the_arm_is_refused():
    with pytest.raises(ValueError, match="kuka/joint_1"):
        Robot('<robot name="x"><link name="a"/></robot>')
