"""The small motion at home tells the two laws of the server apart, or says that it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from kuka_control.loop.servo_law import TURN_RAD, Approach, ServoLawIdentification, lts, verdict

HOME = np.radians([-45.0, 30.0, 0.0, -80.0, 0.0, 70.0, 0.0])
DT = 0.004


def run(law, arm_s=0.027, home=HOME, noise=0.0, late=1, push=None):
    random = np.random.default_rng(3)
    identification, q, readings, goals = ServoLawIdentification(home), home, [home] * (late + 1), []
    for i in range(3000):
        goal, result = identification.step(readings[-1 - late], i * DT)
        goals.append(goal)
        for _ in range(4):
            q = q + 0.25 * DT / arm_s * law(goal - q)
        if push is not None:
            q = q + push
        readings.append(q + noise * random.uniform(-1.0, 1.0, 7))
        if result is not None:
            return result, np.array(goals), q
    raise AssertionError("the identification does not end")


@pytest.mark.parametrize("arm_s", [0.01, 0.02, 0.027, 0.04])
@pytest.mark.parametrize("noise", [0.0, 5e-5])
def test_both_laws_are_distinguished_with_fast_and_slow_drives(arm_s, noise):
    assert run(lts, arm_s, noise=noise)[0].law == "lts"
    assert run(lambda e: e, arm_s, noise=noise)[0].law == "none"


@pytest.mark.parametrize("joint_7", [-3.0, 0.0, 3.0])
def test_only_joint_7_moves_by_half_a_degree_away_from_its_limit_and_back(joint_7):
    home = HOME.copy()
    home[6] = joint_7
    _, goals, q = run(lts, home=home)
    np.testing.assert_array_equal(goals[:, :6], np.tile(home[:6], (len(goals), 1)))
    assert np.max(np.abs(goals[:, 6] - joint_7)) == pytest.approx(TURN_RAD)
    assert np.all(np.abs(goals[:, 6]) <= abs(joint_7) + (TURN_RAD if joint_7 == 0.0 else 1e-12))
    np.testing.assert_array_equal(goals[-1], home)
    assert np.max(np.abs(q - home)) < np.radians(0.07)


def test_an_arm_that_stands_or_is_pushed_gives_no_answer():
    standing, _, _ = run(lambda e: 0.0 * e)
    assert standing.law is None and "did not get through" in standing.evidence
    pushed, _, _ = run(lts, push=np.array([1e-4, 0, 0, 0, 0, 0, 0]))
    assert pushed.law is None and "not to move" in pushed.evidence


def test_between_the_two_the_answer_is_unclear():
    result, _, _ = run(lambda e: 0.3 * e)
    assert result.law is None and "0.1" in result.evidence


@pytest.mark.parametrize("leap", [False, True])
def test_a_leap_of_the_readings_does_not_count_as_the_lts_law(leap):
    """The times fit the law, with a ratio of 2, but nobody saw what happened between the marks."""
    approach = Approach()
    for now, left in [(0.0, 0.5), *([] if leap else [(0.03 * i, 0.5 - 0.05 * i) for i in range(1, 5)])]:
        approach.look(left, now)
    for now, left in [(0.15, 0.25), (0.25, 0.2), (0.35, 0.16), (0.45, 0.125)]:
        approach.look(left, now)
    assert approach.done and approach.needed == pytest.approx(0.45)
    assert approach.law == (None if leap else "lts")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_arm_that_differs_on_its_way_back_leaves_the_law_unclear(sign):
    result, _, _ = run(lambda e: np.where(sign * e > 0.0, lts(e), e))
    assert result.law is None and result.badly_seen


def bad_luck(seed):
    """An arm on a busy machine: drives, speed limit, noise, late and frozen readings, short stalls, all at random."""
    random = np.random.default_rng(seed)
    return {
        "arm_s": random.uniform(0.01, 0.08),
        "slowed": random.choice([1.0, 1.0, random.uniform(0.03, 1.0)]),
        "fastest": random.choice([np.inf, np.inf, random.uniform(0.005, 0.3)]),
        "noise": random.choice([0.0, random.uniform(0.0, 2e-4)]),
        "late": int(random.choice([0.0, 1.0, random.uniform(0.0, 50.0)])),
        "freezes": random.choice([0.0, random.uniform(0.0, 0.2)]),
        "stalls": random.choice([0.0, random.uniform(0.0, 0.5)]),
        "random": random,
    }


def run_badly(law, arm_s, slowed, fastest, noise, late, freezes, stalls, random):
    """The result for an arm whose drives are `slowed` by the speed override, with readings that stay for a while."""
    identification, q, readings = ServoLawIdentification(HOME), HOME, [HOME] * (late + 1)
    now, shown, until = 0.0, HOME, 0.0
    while now < 10.0:
        if now >= until:
            shown = readings[-1 - late]
            until = now + random.exponential(0.1) if random.uniform() < freezes else now
        goal, result = identification.step(shown, now)
        if result is not None:
            return result
        cycles = 4 + (int(random.integers(1, 4)) * 6 if random.uniform() < stalls else 0)  # GAP_S is 30 cycles
        for _ in range(cycles):
            q = q + np.clip(slowed * 0.001 / arm_s * law(goal - q), -0.001 * fastest, 0.001 * fastest)
        now += 0.001 * cycles
        readings.append(q + noise * random.uniform(-1.0, 1.0, 7))
    raise AssertionError("the identification does not end")


@pytest.mark.parametrize("seeds", [range(60), pytest.param(range(60, 300), marks=pytest.mark.long)], ids=str)
def test_however_bad_the_conditions_a_straight_arm_is_never_taken_for_the_lts_law(seeds):
    for seed in seeds:
        result = run_badly(lambda e: e, **bad_luck(seed))
        assert result.law in ("none", None) and not verdict(result, "auto").lts, seed


@pytest.mark.parametrize("seeds", [range(20), pytest.param(range(20, 60), marks=pytest.mark.long)], ids=str)
def test_the_lts_law_is_seldom_missed_and_never_taken_for_the_other_one(seeds):
    for seed in seeds:
        luck = {**bad_luck(seed), "slowed": 1.0, "fastest": np.inf}
        assert run_badly(lts, **luck).law in ("lts", None), seed
        quiet = {**luck, "noise": 2e-5, "freezes": 0.0, "stalls": 0.0, "arm_s": 0.02 + 0.02 * luck["random"].uniform()}
        assert run_badly(lts, **quiet).law == "lts", seed
