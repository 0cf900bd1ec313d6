"""Gravity follows the mounting of the simulated arm; what acts from outside does not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.rotations import rotation_about, rotation_from_zyx, zyx_from_rotation
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.files import read_urdf

URDF = read_urdf("LBR7R800", "MF_elektrisch")
FLOOR = Robot(URDF)
REST = np.zeros(7)
degrees = st.floats(-180.0, 180.0)
joints = st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7).map(np.array)


def gravity(robot, q):
    return robot.torques(q, REST, REST)


@given(joints, degrees)
def test_a_turn_about_the_vertical_changes_nothing(q, yaw):
    np.testing.assert_allclose(gravity(Robot(URDF, (0.0, 0.0, yaw)), q), gravity(FLOOR, q), atol=1e-9)


@given(joints)
def test_on_a_ceiling_gravity_pulls_the_other_way(q):
    for mounting in ((180.0, 0.0, 0.0), (0.0, 180.0, 0.0)):
        np.testing.assert_allclose(gravity(Robot(URDF, mounting), q), -gravity(FLOOR, q), atol=1e-9)


@given(joints, degrees, degrees, degrees, st.floats(-1.0, 1.0))
def test_turning_the_base_about_its_axis_is_turning_joint_1(q, roll, pitch, yaw, turn):
    R = rotation_from_zyx(*np.radians([yaw, pitch, roll])) @ rotation_about(2, turn)
    turned = Robot(URDF, np.degrees(zyx_from_rotation(R)[::-1]))
    q_turned = q + np.array([turn, 0, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(gravity(turned, q), gravity(Robot(URDF, (roll, pitch, yaw)), q_turned), atol=1e-6)


def test_an_arm_that_reaches_out_sideways_from_a_wall_loads_joint_1():
    q = np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert gravity(FLOOR, q)[0] == pytest.approx(0.0, abs=1e-9)
    assert abs(gravity(Robot(URDF, (90.0, 0.0, 0.0)), q)[0]) > 20.0


def test_without_a_load_from_outside_external_torques_are_zero_on_a_ceiling():
    arm = SimulatedArm(Robot(URDF, (180.0, 0.0, 0.0)), ArmSettings())
    arm.q = np.array([0.0, 0.5, 0.0, -1.2, 0.0, -0.7, 0.0])
    np.testing.assert_array_equal(arm.external_torques, REST)
    np.testing.assert_allclose(arm.measured_torques, -gravity(FLOOR, arm.q), atol=1e-9)
    assert arm.safety_stop is None
