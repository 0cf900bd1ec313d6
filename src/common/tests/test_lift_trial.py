"""The reasons of a simulated lift, and its shake."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import lift_trial
from common.lift_trial import SHAKE_S, LiftRecord, outcome, shaken_gravity

RISE = 0.08
heights = st.lists(st.floats(-0.1, 0.2), min_size=3, max_size=3).map(np.array)
records = st.builds(
    LiftRecord,
    st.booleans(),
    heights,
    st.lists(st.booleans(), min_size=3, max_size=3).map(np.array),
    heights,
    heights,
    st.booleans(),
)


@given(records, st.integers(0, 2))
def test_only_the_target_that_stays_up_counts(record, target):
    reason = outcome(record, target, RISE)
    assert (reason == lift_trial.LIFTED) == (record.valid and record.kept[target] > RISE)
    assert reason == lift_trial.LIFTED or reason in lift_trial.FAILURES


STILL = LiftRecord(True, np.zeros(2), np.array([False, False]), np.zeros(2), np.zeros(2))
UP = np.array([0.1, 0.0])


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (STILL, lift_trial.MISSED),
        (STILL._replace(held=np.array([True, False])), lift_trial.SLIPPED),
        (STILL._replace(held=np.array([False, True])), lift_trial.MISSED),
        (STILL._replace(reached=False), lift_trial.COLLISION),
        (STILL._replace(pushed=np.array([0.006, 0.0])), lift_trial.COLLISION),
        (STILL._replace(risen=UP[::-1], kept=UP[::-1]), lift_trial.OTHER_OBJECT),
        (STILL._replace(risen=UP), lift_trial.SHAKEN_OUT),
        (STILL._replace(risen=UP, kept=np.array([0.1, 0.1])), lift_trial.LIFTED),
        (STILL._replace(risen=UP, kept=UP, valid=False), lift_trial.DIVERGED),
        (STILL._replace(kept=np.array([np.nan, 0.0])), lift_trial.DIVERGED),
    ],
)
def test_each_failure_has_its_reason(record, reason):
    assert outcome(record, 0, RISE) == reason


def test_the_shake_is_half_g_along_each_axis_in_turn_and_sums_to_nothing():
    times = np.linspace(0.0, SHAKE_S, 3001)[:-1]
    added = np.array([shaken_gravity(t) for t in times]) + np.array([0.0, 0.0, lift_trial.GRAVITY])
    np.testing.assert_allclose(np.abs(added).max(axis=0), 0.5 * lift_trial.GRAVITY, rtol=1e-4)
    assert ((added != 0.0).sum(axis=1) <= 1).all()
    np.testing.assert_allclose(added.sum(axis=0), 0.0, atol=1e-6)
    for time in (-0.1, SHAKE_S, 2.0):
        np.testing.assert_array_equal(shaken_gravity(time), (0.0, 0.0, -lift_trial.GRAVITY))
