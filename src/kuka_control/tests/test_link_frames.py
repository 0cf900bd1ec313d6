"""Laws of the link frames."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from kuka_control.kinematics import forward
from kuka_control.model.link_frames import link_frames
from kuka_control.robot_model import robot_model

MODEL = robot_model("LBR14R820", "MF_touch_pneumatisch")
joints = arrays(float, 7, elements=st.floats(-3.0, 3.0))


@given(joints)
def test_the_last_frame_is_the_flange_of_the_forward_kinematics(q):
    np.testing.assert_allclose(link_frames(MODEL, q)[-1], forward(MODEL, q), atol=1e-12)


@given(joints)
def test_the_links_keep_their_lengths(q):
    points = np.vstack([np.zeros(3), link_frames(MODEL, q)[[1, 3, 5, 7], :3, 3]])
    lengths = [MODEL.base_shoulder, MODEL.shoulder_elbow, MODEL.elbow_wrist, MODEL.wrist_flange]
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), lengths, atol=1e-12)


@given(joints, st.integers(1, 7), st.floats(-1.0, 1.0))
def test_a_joint_moves_no_link_before_it(q, joint, angle):
    moved = q.copy()
    moved[joint - 1] += angle
    np.testing.assert_array_equal(link_frames(MODEL, moved)[: joint - 1], link_frames(MODEL, q)[: joint - 1])
