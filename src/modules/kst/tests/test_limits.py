"""The last check before numbers leave for the arm."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kst.errors import BadJoints, BadVelocity, KstError
from kst.limits import LBR_IIWA_LIMITS, JointLimits, check_relative_velocity


@given(st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7))
def test_what_is_within_the_ranges_passes_unchanged(q):
    np.testing.assert_array_equal(LBR_IIWA_LIMITS.check(q), q)


@given(st.integers(0, 6), st.floats(1e-6, 1e3), st.sampled_from([-1.0, 1.0]))
def test_what_is_outside_is_named_with_its_range(joint, beyond, side):
    q = np.zeros(7)
    q[joint] = side * (LBR_IIWA_LIMITS.upper[joint] + beyond)
    with pytest.raises(BadJoints) as caught:
        LBR_IIWA_LIMITS.check(q)
    assert caught.value.joint == joint + 1


def test_degrees_are_recognised():
    with pytest.raises(BadJoints, match="radians"):
        LBR_IIWA_LIMITS.check([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_non_finite_joints_are_refused_by_name(bad):
    with pytest.raises(BadJoints) as caught:
        LBR_IIWA_LIMITS.check([0.0, 0.0, bad, 0.0, 0.0, 0.0, 0.0])
    assert caught.value.joint == 3


@pytest.mark.parametrize("q", [[0.0] * 6, [[0.0] * 7], 0.0, None, "seven", [None] * 7, [[0.0], [0.0, 1.0]]])
def test_what_is_not_seven_numbers_is_refused(q):
    with pytest.raises(BadJoints):
        LBR_IIWA_LIMITS.check(q)


def test_own_limits_and_their_faults():
    limits = JointLimits(np.full(7, -0.5), np.full(7, 0.5))
    with pytest.raises(BadJoints, match=r"34.3775 deg .* -28.6479 to 28.6479 deg"):
        limits.check([0.6, 0, 0, 0, 0, 0, 0])
    with pytest.raises(ValueError):
        JointLimits(np.zeros(7), np.zeros(7))
    with pytest.raises(ValueError):
        JointLimits(np.full(7, -np.inf), np.zeros(7))
    with pytest.raises(ValueError, match="read-only"):
        limits.lower[0] = -9.0


@pytest.mark.parametrize("velocity", [0.0, -0.1, 1.0001, 25, math.nan, math.inf, None, "fast"])
def test_relative_velocities_that_the_controller_would_refuse(velocity):
    with pytest.raises(BadVelocity):
        check_relative_velocity(velocity)


def test_refusals_are_also_value_errors():
    assert issubclass(BadJoints, KstError) and issubclass(BadJoints, ValueError)
    assert issubclass(BadVelocity, KstError) and issubclass(BadVelocity, ValueError)
