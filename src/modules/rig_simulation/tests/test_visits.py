"""The operator's hand comes in again where the arm does not follow, but not for ever."""

from __future__ import annotations

import pytest

from rig_simulation.operator.visits import LOST_S, MOST, UNFOLLOWED_S, Visits


@pytest.fixture
def visits():
    made = Visits()
    made.enter(100.0)
    return made


def test_an_arm_that_follows_is_left_alone(visits):
    assert not any(visits.over(True, 100.0 + i) for i in range(60))


def test_an_arm_that_does_not_follow_yet_gets_more_time_than_one_that_stopped(visits):
    assert not visits.over(False, 100.0 + UNFOLLOWED_S - 0.1) and visits.over(False, 100.0 + UNFOLLOWED_S + 0.1)
    assert not visits.over(True, 110.0)
    assert not visits.over(False, 110.0 + LOST_S - 0.1) and visits.over(False, 110.0 + LOST_S + 0.1)
    visits.enter(120.0)
    assert not visits.over(False, 120.0 + LOST_S + 0.1) and visits.over(False, 120.0 + UNFOLLOWED_S + 0.1)


def test_the_last_visit_is_not_given_up(visits):
    for i in range(1, MOST):
        visits.enter(100.0 + i)
    assert not visits.over(False, 1000.0)
