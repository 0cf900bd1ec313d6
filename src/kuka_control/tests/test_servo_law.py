"""The server's law and its inverse, and an arm that follows goals made for it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kuka_control.loop.servo_law import (
    EXTRAPOLATED_S,
    NOISE_RAD,
    REACH_RAD,
    STEP_RAD,
    WIDTH_RAD,
    LtsGoals,
    ServoLawResult,
    lts,
    lts_inverse,
    verdict,
)

RANGE = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])
steps = st.floats(NOISE_RAD, STEP_RAD)
DT = 0.004
ARM_S = 0.027


@given(steps, st.sampled_from([-1.0, 1.0]))
def test_the_inverse_is_an_inverse(size, sign):
    assert lts(lts_inverse(sign * size)) == pytest.approx(sign * size, rel=1e-9)


@given(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_inverse_is_odd_monotone_and_bounded(a, b):
    low, high = lts_inverse(min(a, b)), lts_inverse(max(a, b))
    assert low <= high
    assert lts_inverse(-a) == -lts_inverse(a)
    assert abs(high) <= 1.52 * WIDTH_RAD and abs(low) <= 1.52 * WIDTH_RAD


def test_the_published_numbers():
    """a = 0.07 rad, b = 0.0525 rad: a distance of b is taken to 63 %."""
    np.testing.assert_allclose(lts(np.array([0.0525, -0.0525, 0.0])), [0.0442484, -0.0442484, 0.0], atol=1e-7)
    assert np.all(np.abs(lts(np.array([10.0, -10.0]))) <= REACH_RAD)


def test_noise_is_not_blown_up():
    assert lts_inverse(0.0) == 0.0
    assert lts_inverse(1e-7) < 1e-5


def run(wanted, seconds, noise=0.0, late=2):
    """An arm whose server has the law and whose joints are known `late` cycles late; returns joints and goals."""
    random = np.random.default_rng(5)
    goals = LtsGoals(-RANGE, RANGE)
    q, readings, joints, sent = np.zeros(7), [np.zeros(7)] * (late + 1), [], []
    for i in range(round(seconds / DT)):
        q_wanted, v = wanted(i * DT)
        goal = goals.step(q_wanted, v, readings[-1 - late], DT)
        for _ in range(4):
            q = q + 0.25 * DT / ARM_S * lts(goal - q)
        readings.append(q + noise * random.uniform(-1.0, 1.0, 7))
        joints.append(q)
        sent.append(goal)
    return np.array(joints), np.array(sent)


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.5, 1.0])
def test_a_ramp_is_followed_as_closely_as_with_a_straight_law(speed):
    joints, _ = run(lambda t: (np.full(7, speed * t), np.full(7, speed)), 1.5)
    behind = speed * DT * (len(joints) - 1) - joints[-1]
    assert np.all(np.abs(behind) < 1.5 * speed * ARM_S + 1e-4)


def test_at_rest_nothing_rings_also_with_noise_and_late_readings():
    for noise in (0.0, 1e-5, 1e-4):
        joints, sent = run(lambda t: (np.full(7, 0.01), np.zeros(7)), 3.0, noise, late=3)
        rest = joints[-250:]
        assert np.max(np.abs(rest - 0.01)) < 1e-5 + 3.0 * noise
        assert np.max(np.abs(np.diff(rest, axis=0))) < 1e-7 + 2.0 * noise


def test_a_step_is_not_overshot():
    joints, _ = run(lambda t: (np.full(7, 0.05), np.zeros(7)), 1.0)
    assert np.max(joints) < 0.0515 and joints[-1, 0] == pytest.approx(0.05, abs=1e-4)


@given(st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7).map(np.array), st.floats(-30.0, 30.0))
def test_goals_are_never_far_from_the_arm_and_within_the_joint_ranges(wanted, speed):
    goals = LtsGoals(-RANGE, RANGE)
    measured = 0.9 * RANGE
    for _ in range(10):
        sent = goals.step(wanted, np.full(7, speed), measured, DT)
        assert np.all(np.abs(sent) <= RANGE)
        assert np.all(np.abs(sent - measured) <= 1.52 * WIDTH_RAD + min(EXTRAPOLATED_S * abs(speed), STEP_RAD) + 1e-12)


@pytest.mark.parametrize("servo_law", ["lts", "none"])
@pytest.mark.parametrize("law", ["lts", "none", None])
def test_goals_are_made_for_the_lts_law_only_where_it_was_identified_and_is_set(law, servo_law):
    """For another law such goals are far too large, so an unclear one counts as none."""
    result = verdict(ServoLawResult(law, "evidence"), servo_law)
    assert result.lts == (law == servo_law == "lts")
    assert result.refused == (law == "none" and servo_law == "lts")
