"""Steps of a motion before it starts."""

import numpy as np
import pytest

from kuka_control.model.joint_configurations import ARRIVED_DEG, JointMotion

ZERO, BENT = np.zeros(7), np.radians([0.0, 20.0, 10.0, -110.0, 0.0, 90.0, -45.0])


def test_the_largest_step_has_joint_and_sign():
    assert JointMotion(ZERO, BENT).largest == (4, pytest.approx(-110.0))
    assert JointMotion(BENT, ZERO).largest == (4, pytest.approx(110.0))


def test_where_the_arm_is_already_no_motion_is_needed():
    assert not JointMotion(BENT, BENT + np.radians(0.9 * ARRIVED_DEG)).needed
    assert JointMotion(BENT, BENT + np.radians(1.1 * ARRIVED_DEG)).needed


def test_the_table_has_no_minus_zero():
    lines = JointMotion(-1e-9 * np.ones(7), BENT).table()
    assert len(lines) == 8
    assert lines[1].split() == ["1", "0.0", "0.0", "+0.0"]
    assert lines[4].split() == ["4", "0.0", "-110.0", "-110.0"]
