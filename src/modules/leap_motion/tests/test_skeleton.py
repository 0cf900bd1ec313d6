"""What is drawn of a hand: pure."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from leap_motion.frames import TrackedHand
from leap_motion.skeleton import AXIS_M, skeleton, traffic_light

UNIT = st.floats(0.0, 1.0)
COORDINATE = st.floats(-0.4, 0.4)
PALM = (0.01, 0.2, -0.03)


def hand(joints=None, confidence=0.9, palm=PALM, is_left=False):
    return TrackedHand(7, is_left, palm, (0.0, 0.0, -1.0), (0.0, -1.0, 0.0), confidence, joints=joints)


@given(st.lists(COORDINATE, min_size=75, max_size=75), UNIT)
def test_every_bone_joins_two_joints_of_one_finger(coordinates, confidence):
    joints = np.array(coordinates).reshape(5, 5, 3)
    drawn = skeleton(hand(joints, confidence))
    assert_array_equal(drawn.bones.reshape(5, 4, 2, 3)[:, :, 0], joints[:, :4])
    assert_array_equal(drawn.bones.reshape(5, 4, 2, 3)[:, :, 1], joints[:, 1:])
    assert_array_equal(drawn.joints[:25].reshape(5, 5, 3), joints)
    assert_array_equal(drawn.joints[25], PALM)
    assert drawn.label_at[1] > max(drawn.joints[:, 1])


def test_palm_axes_point_along_fingers_and_out_of_the_palm_also_without_joints():
    drawn = skeleton(hand(None, is_left=True, confidence=0.25))
    assert drawn.bones.shape == (0, 3) and drawn.joints.shape == (1, 3)
    assert_allclose(drawn.direction, [PALM, np.add(PALM, (0.0, 0.0, -AXIS_M))])
    assert_allclose(drawn.normal, [PALM, np.add(PALM, (0.0, -AXIS_M, 0.0))])
    assert drawn.label == "left hand 7, confidence 0.25"


@pytest.mark.parametrize("place", ["joints", "palm"])
def test_a_hand_with_numbers_that_are_none_is_not_drawn(place):
    joints = np.zeros((5, 5, 3))
    joints[4, 4, 2] = np.nan if place == "joints" else 0.0
    assert skeleton(hand(joints, palm=(0.0, np.inf, 0.0) if place == "palm" else (0.0, 0.2, 0.0))) is None


def test_ends_of_the_scale_and_what_is_no_number():
    red, green = traffic_light(0.0), traffic_light(1.0)
    assert red[0] == 1.0 and red[1] == 0.0 and green[0] == 0.0 and green[1] > 0.8
    assert traffic_light(-3.0) == traffic_light(np.nan) == red and traffic_light(7.0) == green
