"""Forward kinematics against poses of the toolbox's own chain, and the Jacobian against differences."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from common.poses import pose
from common.rotations import rotation_from_zyx
from iiwa_kinematics import Kinematics, arm_points, forward, jacobian, robot_model

MODEL = robot_model("LBR7R800", "MF_elektrisch")
TURNED = np.radians([10.0, 20.0, 30.0, -40.0, 50.0, 60.0, 70.0])
joints = st_numpy.arrays(float, 7, elements=st.floats(-3.0, 3.0))

# Joints, arm, media flange; position [mm] and angles about z, y, x [rad] of the flange by the toolbox's chain.
PUBLISHED = [
    (np.zeros(7), "LBR7R800", "MF_elektrisch", (0, 0, 1301), (0, 0, 0)),
    (np.zeros(7), "LBR14R820", "MF_elektrisch", (0, 0, 1341), (0, 0, 0)),
    (np.radians([0, 30, 0, -60, 0, 90, 0]), "LBR7R800", "MF_elektrisch", (600, 0, 525.4102), (np.pi, 0, np.pi)),
    (TURNED, "LBR7R800", "MF_elektrisch", (443.5973, 363.8146, 914.0745), (2.958711, -0.495729, 1.666864)),
    (TURNED, "LBR7R800", "MF_touch_pneumatisch", (447.1375, 389.4789, 911.8808), (2.958711, -0.495729, 1.666864)),
    (TURNED, "LBR14R820", "MF_elektrisch", (450.3338, 365.0024, 952.8683), (2.958711, -0.495729, 1.666864)),
]


@pytest.mark.parametrize("q, robot, flange, millimetres, angles", PUBLISHED)
def test_flange_stands_where_the_toolbox_says(q, robot, flange, millimetres, angles):
    T = forward(robot_model(robot, flange), q)
    np.testing.assert_allclose(T[:3, 3] * 1000.0, millimetres, atol=1e-4)
    np.testing.assert_allclose(T[:3, :3], rotation_from_zyx(*angles), atol=2e-6)


@given(joints, st_numpy.arrays(float, 3, elements=st.floats(-0.3, 0.3)))
def test_jacobian_is_the_derivative(q, tool):
    T_flange_tool = pose(rotation_from_zyx(0.3, -0.2, 0.1), tool)
    kinematics = Kinematics(MODEL, T_flange_tool)
    J = jacobian(MODEL, q, T_flange_tool)
    h = 1e-6
    for i in range(7):
        step = np.zeros(7)
        step[i] = h
        before, after = kinematics.forward(q - step), kinematics.forward(q + step)
        np.testing.assert_allclose(J[:3, i], (after - before)[:3, 3] / (2 * h), atol=1e-7)
        turned = pin.log3(after[:3, :3] @ before[:3, :3].T) / (2 * h)
        np.testing.assert_allclose(J[3:, i], turned, atol=1e-7)


@given(joints)
def test_points_of_the_arm_keep_its_lengths(q):
    points = arm_points(MODEL, q)
    lengths = [MODEL.base_shoulder, MODEL.shoulder_elbow, MODEL.elbow_wrist, MODEL.wrist_flange]
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), lengths, atol=1e-12)
    np.testing.assert_array_equal(points[-1], forward(MODEL, q)[:3, 3])


@given(joints, st_numpy.arrays(float, 3, elements=st.floats(-0.3, 0.3)))
def test_the_tool_point_is_that_of_the_pose_and_the_reach_that_of_the_farthest_of_tool_elbow_and_wrist(q, tool):
    kinematics = Kinematics(MODEL, pose(rotation_from_zyx(0.3, -0.2, 0.1), tool))
    point, reaches = kinematics.tool_point(q.tolist())
    np.testing.assert_allclose(point, kinematics.forward(q)[:3, 3], atol=1e-12)
    each = [np.linalg.norm(J, axis=0) for J in (kinematics.jacobian(q)[:3], *point_jacobians(MODEL, q)[:2])]
    np.testing.assert_allclose(reaches, np.max(each, axis=0), atol=1e-12)
    wide = np.array(kinematics.tool_point(q.tolist(), 0.1)[1])
    assert np.all(wide >= np.max([each[0] + 0.1, *each[1:]], axis=0) - 1e-12)


def point_jacobians(model, q):
    """Of elbow, wrist and flange, shape (3, 7) each: how each joint would move them."""
    _, _, elbow, wrist, flange = arm_points(model, q)
    J = jacobian(model, q)
    across = [J[:3] + np.cross(J[3:].T, point - flange).T for point in (elbow, wrist, flange)]
    for J_point, joints_before in zip(across, (2, 4, 7)):
        J_point[:, joints_before:] = 0.0
    return across


@given(
    joints,
    st_numpy.arrays(float, 7, elements=st.floats(-3.0, 3.0)),
    st_numpy.arrays(float, (3, 4), elements=st.floats(0.0, 0.3)),
)
def test_the_fastest_point_is_the_fastest_of_elbow_wrist_flange_and_balls(q, v, balls):
    T, J = forward(MODEL, q), jacobian(MODEL, q)
    velocity, turn = J[:3] @ v, J[3:] @ v
    speeds = [np.linalg.norm(J_point @ v) for J_point in point_jacobians(MODEL, q)]
    for *centre, radius in balls:
        at_centre = np.linalg.norm(velocity + np.cross(turn, T[:3, :3] @ centre))
        speeds.append(at_centre + radius * np.linalg.norm(turn))
    fastest = Kinematics(MODEL).fastest_point([tuple(ball) for ball in balls.tolist()], q.tolist(), v.tolist())
    np.testing.assert_allclose(fastest, max(speeds), atol=1e-12)
