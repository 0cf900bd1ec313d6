"""Laws of the random positions in and around the workspace."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.limits import BOUNDS
from kuka_control.model.workspace import Workspace
from kuka_control.model.workspace_study import SEVERAL, UNCHANGED, constrained_samples, volume_samples

COUNT = 400


def workspace(heading=-0.8, opening=50.0, low=0.2, high=0.6, inner=0.5, outer=0.7):
    line = [math.cos(heading), math.sin(heading), 0.0]
    return Workspace(line, math.radians(opening), low, high, inner, outer, 0.34)


workspaces = st.builds(
    workspace,
    st.floats(-3.1, 3.1),
    st.floats(5.0, 175.0),
    st.floats(0.11, 0.3),
    st.floats(0.35, 0.7),
    st.floats(0.41, 0.55),
    st.floats(0.6, 0.79),
)


@settings(max_examples=30)
@given(workspaces, st.integers(0, 1000))
def test_volume_samples_lie_in_the_workspace(space, seed):
    positions = volume_samples(space, 50, np.random.default_rng(seed))
    assert positions.shape == (50, 3)
    assert all(space.contains(position) for position in positions)


def test_volume_samples_are_spread_evenly_over_the_volume():
    space = workspace()
    positions = volume_samples(space, 20_000, np.random.default_rng(3))
    heights = np.linspace(space.z_lower, space.z_upper, 2001)
    areas = np.array([outer**2 - inner**2 for inner, outer in map(space.radii, heights)])
    below = heights < 0.3
    expected = areas[below].sum() / areas.sum()
    assert np.mean(positions[:, 2] < 0.3) == pytest.approx(expected, abs=0.015)
    # In a slice, half of the samples lie outside of the radius that halves its area.
    slice_ = positions[np.abs(positions[:, 2] - 0.34) < 0.02]
    middle = math.sqrt((0.5**2 + 0.7**2) / 2.0)
    assert np.mean(np.hypot(slice_[:, 0], slice_[:, 1]) > middle) == pytest.approx(0.5, abs=0.03)
    turns = np.arctan2(positions[:, 1], positions[:, 0]) - space.heading
    assert np.mean(turns > 0.0) == pytest.approx(0.5, abs=0.015)


@settings(max_examples=30)
@given(workspaces, st.integers(0, 1000))
def test_constrained_samples_are_in_the_workspace_and_say_what_acted(space, seed):
    samples = constrained_samples(space, 60, np.random.default_rng(seed))
    assert len(samples.raw) == len(samples.position) == len(samples.acted)
    assert len(samples.raw) + len(samples.infeasible) == 60
    assert all(space.contains(position) for position in samples.position)
    unchanged = np.all(samples.raw == samples.position, axis=1)
    np.testing.assert_array_equal(samples.group(UNCHANGED), unchanged)


def test_every_bound_has_its_samples_and_each_sample_one_group():
    samples = constrained_samples(workspace(), COUNT, np.random.default_rng(0))
    groups = np.array([samples.group(acted) for acted in (UNCHANGED, SEVERAL, *(bound.value for bound in BOUNDS))])
    assert np.all(groups.sum(axis=1) > 5)
    np.testing.assert_array_equal(groups.sum(axis=0), 1)


@pytest.mark.parametrize("draw", [volume_samples, lambda *a: constrained_samples(*a).raw])
def test_equal_seeds_give_equal_samples(draw):
    space = workspace()
    first, again, other = (draw(space, 20, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
