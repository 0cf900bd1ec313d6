"""The scaling factor: its laws and its range."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as st_numpy

from kuka_control.model.switches import check_scaling_factor
from kuka_control.model.target import scaled

positions = st_numpy.arrays(float, 3, elements=st.floats(-2.0, 2.0))
factors = st.floats(0.1, 1.5)


@pytest.mark.hazard(21)
@given(positions, positions, factors)
def test_the_way_from_the_centre_is_scaled(position, centre, factor):
    np.testing.assert_allclose(scaled(position, centre, factor) - centre, factor * (position - centre), atol=1e-12)


@given(positions, factors)
def test_the_centre_stays(centre, factor):
    np.testing.assert_array_equal(scaled(centre, centre, factor), centre)


@given(positions, positions)
def test_factor_one_changes_nothing(position, centre):
    np.testing.assert_allclose(scaled(position, centre, 1.0), position, atol=1e-12)


@given(factors)
def test_factors_of_the_range_are_accepted(factor):
    assert check_scaling_factor(factor) == factor
