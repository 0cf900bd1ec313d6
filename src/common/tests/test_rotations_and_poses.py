"""Laws of rotations and poses, and what is refused at their border."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import poses
from common import rotations as rot

angles = st.floats(-10.0, 10.0)


@given(angles, angles, angles)
def test_zyx_angles_round_trip(a, b, c):
    R = rot.rotation_from_zyx(a, b, c)
    np.testing.assert_allclose(rot.rotation_from_zyx(*rot.zyx_from_rotation(R)), R, atol=1e-12)


@pytest.mark.parametrize("b", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-10])
def test_zyx_angles_round_trip_at_the_singularity(b):
    R = rot.rotation_from_zyx(0.4, b, -1.1)
    np.testing.assert_allclose(rot.rotation_from_zyx(*rot.zyx_from_rotation(R)), R, atol=1e-9)


@given(angles, angles, angles)
def test_zyx_is_z_then_y_then_x(a, b, c):
    R = rot.rotation_about(2, a) @ rot.rotation_about(1, b) @ rot.rotation_about(0, c)
    np.testing.assert_allclose(rot.rotation_from_zyx(a, b, c), R, atol=1e-12)


@given(angles, angles, angles)
def test_quaternion_round_trip(a, b, c):
    R = rot.rotation_from_zyx(a, b, c)
    q = rot.quaternion_from_rotation(R)
    assert q[3] >= 0.0
    np.testing.assert_allclose(np.linalg.norm(q), 1.0, atol=1e-12)
    np.testing.assert_allclose(rot.rotation_from_quaternion(q), R, atol=1e-12)


@given(st.lists(st.tuples(angles, angles, angles), min_size=1, max_size=5))
def test_quaternions_of_many_rotations_at_once(triples):
    R = np.array([rot.rotation_from_zyx(*triple) for triple in triples])
    expected = [rot.quaternion_from_rotation(one) for one in R]
    np.testing.assert_allclose(rot.quaternions_from_rotations(R), expected, atol=1e-15)


@given(angles, angles, angles)
def test_a_steady_quaternion_is_the_same_rotation_whatever_its_sign_was(a, b, c):
    R = rot.rotation_from_zyx(a, b, c)
    q = rot.quaternion_from_rotation(R)
    np.testing.assert_allclose(rot.rotation_from_quaternion(rot.steady_quaternion(q)), R, atol=1e-12)
    np.testing.assert_array_equal(rot.steady_quaternion([q, -q]), [rot.steady_quaternion(q)] * 2)


@given(st.integers(-4, 4), angles, angles, st.floats(0.0, np.radians(20.0)))
def test_a_tool_that_points_down_keeps_the_sign_of_its_steady_quaternion(yaw, around, up, turn):
    R = rot.rotation_from_zyx(yaw * np.pi / 4, np.pi, 0.0)
    axis = np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
    turned = R @ pin.exp3(turn * axis)
    before, after = (rot.steady_quaternion(rot.quaternion_from_rotation(one)) for one in (R, turned))
    assert before @ after > 0.98


@given(angles, angles, angles)
def test_quaternions_are_those_of_pinocchio(a, b, c):
    R = rot.rotation_from_zyx(a, b, c)
    q = pin.Quaternion(R).normalized().coeffs()
    np.testing.assert_allclose(rot.quaternion_from_rotation(R), -q if q[3] < 0.0 else q, atol=1e-15)


@given(angles, angles, angles, st.floats(0.0, 1.0))
def test_shares_of_a_rotation_add_up_to_it(a, b, c, share):
    R = rot.rotation_from_zyx(a, b, c)
    first, rest = rot.scaled_rotation(R, share), rot.scaled_rotation(R, 1.0 - share)
    np.testing.assert_allclose(first @ rest, R, atol=1e-6)
    np.testing.assert_allclose(rot.rotation_angle(first), share * rot.rotation_angle(R), atol=1e-6)


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [0, 0, 0, 1.01], [np.nan, 0, 0, 1], [0, 0, 1], [np.inf, 0, 0, 0]])
def test_a_bad_quaternion_is_refused(q):
    with pytest.raises(ValueError):
        rot.rotation_from_quaternion(q)


def test_a_slightly_long_quaternion_is_normalised():
    np.testing.assert_allclose(rot.rotation_from_quaternion([0, 0, 0, 1.0009]), np.eye(3), atol=1e-12)


@given(st.floats(0.0, np.pi), st.integers(0, 2))
def test_rotation_angle(angle, axis):
    np.testing.assert_allclose(rot.rotation_angle(rot.rotation_about(axis, angle)), angle, atol=1e-7)


@pytest.mark.parametrize(
    "R", [np.diag([1, 1, -1]), 1.1 * np.eye(3), np.full((3, 3), np.nan), np.eye(4), np.ones((3, 3))]
)
def test_what_is_no_rotation_is_refused(R):
    with pytest.raises(ValueError):
        rot.check_rotation(R)


@pytest.mark.parametrize("v", [[0, 0, 0], [np.nan, 1, 0], [np.inf, 1, 0]])
def test_a_vector_without_direction_is_refused(v):
    with pytest.raises(ValueError, match="has no direction"):
        rot.unit(v)


@given(st.tuples(angles, angles, angles), st.tuples(angles, angles, angles))
def test_cross_product_is_numpys(a, b):
    np.testing.assert_array_equal(rot.cross(np.array(a), np.array(b)), np.cross(a, b))


@given(angles, angles, angles, st.tuples(angles, angles, angles))
def test_inverse_pose(a, b, c, p):
    T = poses.pose(rot.rotation_from_zyx(a, b, c), p)
    np.testing.assert_allclose(T @ poses.inverse(T), np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(poses.check_pose(T), T)


def test_what_is_no_pose_is_refused():
    for T in (np.eye(3), np.diag([1, 1, 1, 2.0]), np.diag([1, 1, -1, 1.0]), np.full((4, 4), np.nan)):
        with pytest.raises(ValueError):
            poses.check_pose(T)
