"""The controller's scaling, as leap_kuka reckons with it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose
from kuka_control.model import target
from leap_kuka.scaling import Scaling

vectors = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@given(vectors, vectors, vectors, st.floats(0.1, 2.0))
def test_what_is_unscaled_comes_back_where_the_controller_brings_it(p, centre, offset, factor):
    scaling, T = Scaling(centre, factor, offset), pose(p=p)
    desired = scaling.unscaled(T)[:3, 3]
    np.testing.assert_allclose(scaling.scaled(desired), p, atol=1e-9)
    np.testing.assert_allclose(target.scaled(desired, centre, factor) + offset, p, atol=1e-9)


@pytest.mark.parametrize("factor, offset", [(0.0, 0.0), (math.nan, 0.0), (math.inf, 0.0), (-1.0, 0.0), (1.0, math.nan)])
def test_a_scaling_that_is_none_is_refused(factor, offset):
    scaling = Scaling(np.zeros(3), factor, np.full(3, offset))
    with pytest.raises(ValueError, match="scaling factor is"):
        scaling.unscaled(np.eye(4))
    np.testing.assert_array_equal(scaling.scaled(np.ones(3)), np.ones(3))
