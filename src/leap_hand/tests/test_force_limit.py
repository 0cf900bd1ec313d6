"""The force limit: laws of what is sent while fingers press, without ROS."""

import dataclasses
import math
import random
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from leap_hand.config import HandConfig
from leap_hand.force_limit import FingerFeedback, ForceLimit

SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_hand.yaml").read_text())
CONFIG = parse(HandConfig, SHIPPED, "leap_hand/")
PRESSURE, LOAD, RELEASE = CONFIG.force_limit_pressure, CONFIG.force_limit_load, CONFIG.force_limit_release
FIST = (2.0, 2.0, 1.8, 0.3)

angle = st.floats(0.0, 3.6)
taxel = st.floats(-20.0, 200.0)
moment = st.tuples(
    st.tuples(angle, angle, angle),
    st.tuples(taxel, taxel, taxel),
    st.tuples(*[st.floats(-400.0, 600.0)] * 3),
    st.tuples(angle, angle, angle, st.floats(0.0, 0.7)),
)


def state(angles=(0.0, 0.0, 0.0), pressures=(0.0, 0.0, 0.0), loads=(0.0, 0.0, 0.0), taxel=4):
    """A state in which one taxel of each finger is pressed."""
    taxels = [tuple(pressure if i == taxel else 0.0 for i in range(9)) for pressure in pressures]
    return FingerFeedback(tuple(angles), tuple(taxels), tuple(loads))


def over(pressure, load):
    return pressure > PRESSURE or load > LOAD


@pytest.mark.hazard(17)
@given(st.lists(moment, min_size=2, max_size=30))
def test_a_finger_that_presses_never_closes_further_and_never_more_than_commanded(moments):
    limit = ForceLimit(CONFIG)
    before = np.zeros(4)
    for now, (angles, pressures, loads, command) in enumerate(moments):
        limit.update(state(angles, pressures, loads), 0.025 * now)
        sent = limit.clip(command, 0.025 * now).command
        assert np.all(sent <= command) and sent[3] == command[3]
        for i in range(3):
            if over(pressures[i], loads[i]):
                assert sent[i] <= before[i]
        before = sent


@given(st.lists(moment, min_size=1, max_size=20), angle)
def test_opening_is_always_allowed(moments, wanted):
    limit = ForceLimit(CONFIG)
    for now, (angles, pressures, loads, command) in enumerate(moments):
        limit.update(state(angles, pressures, loads), 0.025 * now)
        sent = limit.clip(command, 0.025 * now).command
    wanted = min(wanted, *sent[:3])
    np.testing.assert_array_equal(limit.clip((wanted,) * 4, 100.0).command, [wanted] * 4)


@given(st.lists(moment, min_size=1, max_size=20))
def test_untouched_fingers_follow_their_commands(moments):
    limit = ForceLimit(CONFIG)
    for now, (angles, pressures, loads, command) in enumerate(moments):
        free = state(angles, (pressures[0], 0.0, 0.0), (loads[0], 0.0, 0.0))
        limit.update(free, 0.025 * now)
        np.testing.assert_array_equal(limit.clip(command, 0.025 * now).command[1:], command[1:])


@pytest.mark.parametrize("finger, name", enumerate(("index", "middle", "thumb")))
@pytest.mark.parametrize("how", ["pressure", "load"])
def test_a_finger_stops_where_it_stands_and_says_why(finger, name, how):
    limit = ForceLimit(CONFIG)
    limit.update(state(), 0.0)
    limit.clip(FIST, 0.0)
    pressed = [0.0] * 3
    pressed[finger] = (PRESSURE if how == "pressure" else LOAD) + 1.0
    touched = state((1.2,) * 3, **{"pressures" if how == "pressure" else "loads": pressed})
    assert limit.update(touched, 0.025)
    assert not limit.update(touched, 0.05), "it was stopped already"
    sent = limit.clip(FIST, 0.05)
    expected = np.array(FIST)
    expected[finger] = 1.2
    np.testing.assert_allclose(sent.command, expected)
    assert sent.limited == {name: "taxel 4: 61 counts" if how == "pressure" else "load 231"}
    assert limit.trips == 1


def test_it_closes_again_only_after_both_have_fallen_below_the_share():
    limit = ForceLimit(CONFIG)
    limit.update(state(), 0.0)
    limit.clip(FIST, 0.0)
    limit.update(state((1.2,) * 3, (PRESSURE + 1.0, 0.0, 0.0)), 0.0)
    for pressure, load in ((PRESSURE * RELEASE + 1.0, 0.0), (0.0, LOAD * RELEASE + 1.0)):
        limit.update(state((1.2,) * 3, (pressure, 0.0, 0.0), (load, 0.0, 0.0)), 0.0)
        assert limit.clip(FIST, 0.0).command[0] == pytest.approx(1.2)
    limit.update(state((1.2,) * 3, (PRESSURE * RELEASE - 1.0, 0.0, 0.0)), 0.0)
    released = limit.clip(FIST, 0.0)
    assert released.command[0] == FIST[0] and not released.limited


@pytest.mark.parametrize("seed", range(5))
def test_no_chatter_on_a_soft_thing_under_noise(seed):
    """A finger at 3 rad/s on a spring of 90 counts/rad, felt 50 ms late with noise of 3 counts."""
    rng = random.Random(seed)
    limit = ForceLimit(CONFIG)
    finger, late = 0.0, [0.0, 0.0]
    angles = []
    for step in range(400):
        late.append(90.0 * max(0.0, finger - 0.8) + rng.gauss(0.0, 3.0))
        limit.update(state((finger,) * 3, (late[-3], 0.0, 0.0)), 0.025 * step)
        goal = limit.clip(FIST, 0.025 * step).command[0]
        finger += max(-0.075, min(0.075, goal - finger))
        angles.append(finger)
    assert limit.trips == 1
    assert np.ptp(angles[100:]) == 0.0 and 0.8 < finger < 1.8


def test_without_the_state_of_the_hand_no_finger_closes():
    limit = ForceLimit(CONFIG)
    sent = limit.clip(FIST, 0.0)
    np.testing.assert_array_equal(sent.command, [0.0, 0.0, 0.0, FIST[3]])
    assert sent.silence
    limit.update(state(), 1.0)
    assert limit.clip((1.0, 1.0, 1.0, 0.0), 1.0 + CONFIG.force_limit_silence).silence == ""
    silent = limit.clip(FIST, 1.01 + CONFIG.force_limit_silence)
    np.testing.assert_array_equal(silent.command[:3], [1.0] * 3)
    assert silent.silence
    np.testing.assert_array_equal(limit.clip((0.5,) * 4, 9.0).command, [0.5] * 4)
    limit.update(state(), 10.0)
    np.testing.assert_array_equal(limit.clip(FIST, 10.0).command, FIST)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("field", ["angles", "pressures", "loads"])
def test_numbers_that_are_not_finite_are_no_state(field, bad):
    limit = ForceLimit(CONFIG)
    assert not limit.update(state(**{field: (bad, 0.0, 0.0)}), 0.0)
    assert limit.clip(FIST, 0.0).silence


def test_switched_off_it_lets_everything_through():
    limit = ForceLimit(dataclasses.replace(CONFIG, force_limit=False))
    assert not limit.update(state(pressures=(190.0,) * 3), 0.0)
    sent = limit.clip(FIST, 0.0)
    np.testing.assert_array_equal(sent.command, FIST)
    assert (sent.limited, sent.silence, limit.trips) == ({}, "", 0)


def above(name):
    more = yaml.safe_load((Path(__file__).parents[1] / "config" / f"{name}.yaml").read_text())
    return parse(HandConfig, {**SHIPPED, **more}, "leap_hand/")


def test_the_full_grip_fits_above_the_shipped_file_and_keeps_the_limit():
    full = above("full_grip")
    assert full.force_limit and np.all(full.robot[:3, 1] > CONFIG.robot[:3, 1])


def test_the_firm_grip_presses_harder_but_less_than_makes_the_driver_loosen_a_finger():
    firm = above("firm_grip")
    assert firm.force_limit and firm.force_limit_pressure > CONFIG.force_limit_pressure
    assert CONFIG.force_limit_load < firm.force_limit_load < 350.0
    np.testing.assert_array_equal(firm.robot, CONFIG.robot)
