"""Force and moment at the tool, found again from the joint torques that they make."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from common.poses import translation
from iiwa_kinematics import Kinematics, jacobian
from iiwa_kinematics.robot_model import robot_model
from kuka_control.model.tool_load import wrench_at_tool

ARM = Kinematics(robot_model("LBR7R800", "MF_elektrisch"), translation(0.0, 0.0, 0.106))
HOME = np.array([-0.785, 0.516, 0.0, -1.106, 0.0, 1.519, 0.0])
numbers = st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3).map(np.array)
near_home = st.lists(st.floats(-0.3, 0.3), min_size=7, max_size=7).map(lambda d: HOME + np.array(d))


@given(near_home, numbers, numbers)
def test_force_and_moment_are_found_from_their_torques(q, force, moment):
    R = ARM.forward(q)[:3, :3]
    wrench = np.concatenate([R @ force, R @ moment])
    torques = jacobian(ARM.model, q, ARM.T_flange_tool).T @ wrench
    np.testing.assert_allclose(wrench_at_tool(ARM, q, torques), (force, moment), atol=1e-8)


def test_a_singular_pose_gives_finite_numbers():
    assert np.all(np.abs(np.concatenate(wrench_at_tool(ARM, np.zeros(7), np.full(7, 5.0)))) < 200.0)
