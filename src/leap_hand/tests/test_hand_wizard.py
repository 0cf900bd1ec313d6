"""The measurement of a person's hand: what it stores, and what it refuses."""

import dataclasses
import functools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import parse
from leap_hand.config import FINGERS, HandConfig
from leap_hand.flexion import flexion, map_angles
from leap_hand.hand_wizard import INSTRUCTIONS, MIN_RANGE_DEG, OPEN, HandWizard, as_yaml
from leap_hand.numbers import HOLD_S
from leap_motion.frames import FingerPoints, TrackedHand, TrackingFrame
from rig_simulation.operator.hand_model import HandModel, HandPose, fingers_for

SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_hand.yaml").read_text())
CONFIG = parse(HandConfig, SHIPPED, "leap_hand/")


@functools.lru_cache(maxsize=1000)
def synthetic_hand(curl=0.0, scale=1.0, side="right", thumb=None, noise=None):
    """A hand of the simulated Leap; `thumb`: the most that the thumb curls; `noise`: the seed of 0.3 mm of noise."""
    flexed, spread = fingers_for(curl)
    if thumb is not None:
        own_flexed, own_spread = fingers_for(min(curl, thumb))
        flexed[0], spread[0] = own_flexed[0], own_spread[0]
    placed = HandModel(side, scale).place(HandPose(np.array([10.0, 300.0, -20.0]), 0.1, 0.1, 0.05, flexed, spread))
    joints = placed.joints / 1e3
    if noise is not None:
        joints = joints + np.random.default_rng(noise).normal(0.0, 3e-4, joints.shape)
    bones = (joints[:, 2] + joints[:, 3]) / 2.0
    points = FingerPoints(joints[1, 4], joints[2, 4], joints[0, 4], bones[1], bones[2])
    return TrackedHand(3, side == "left", placed.palm / 1e3, placed.direction, placed.normal, 1.0, points)


def percent_of(remark):
    return float(remark.split(" %")[0].rsplit(" ", 1)[1])


class Person:
    """Shows hands to a wizard at 50 Hz."""

    def __init__(self):
        self.wizard = HandWizard(CONFIG)
        self.now, self.number = 10.0, 0

    def show(self, *hands, seconds=1.0, age=0.0):
        for _ in range(round(50 * seconds)):
            self.now, self.number = self.now + 0.02, self.number + 1
            step = self.wizard.step(TrackingFrame(self.number, age, hands), self.now)
        return step

    def obey(self, hand_of, repetitions=2, **kwargs):
        """Opens and closes the hand: `hand_of(curl)`; the way between takes 0.3 s."""
        for curl in (0.0, 1.0) * repetitions:
            for part in np.linspace(1.0 - curl, curl, 15):
                self.show(hand_of(part), seconds=0.02)
            step = self.show(hand_of(curl), **kwargs)
        return step


def mapped(result, hand):
    """How far a calibrated hand closes the robot's fingers, 0 to 1, shape (4,)."""
    config = parse(HandConfig, {**SHIPPED, **result.values})
    return map_angles(flexion(hand.palm, hand.normal, hand.fingers), config.human, np.array([[0.0, 1.0]] * 4))


@settings(max_examples=10)
@given(st.floats(0.7, 1.2), st.sampled_from(["left", "right"]), st.floats(0.5, 1.0), st.integers(0, 1000))
def test_open_opens_and_closed_closes_every_finger_of_hands_of_all_sizes(scale, side, most, seed):
    rng, person = np.random.default_rng(seed), Person()

    def hand(curl):
        return synthetic_hand(round(most * curl, 3), scale, side, noise=int(rng.integers(20)))

    assert person.obey(hand).done
    result = person.wizard.result()
    assert result.remarks == ()
    assert (mapped(result, hand(0.0)) <= 0.05).all()
    assert (mapped(result, hand(1.0))[:3] >= 0.95).all()
    assert mapped(result, hand(1.0))[3] <= 0.05, "neither hand spreads the robot hand"
    parse(HandConfig, {**SHIPPED, **yaml.safe_load(as_yaml("anna", result, simulated=False))})


@given(st.floats(0.7, 1.2), st.floats(0.0, 0.15))
@settings(max_examples=5)
def test_a_thumb_that_hardly_closes_still_opens_the_robots_thumb(scale, thumb):
    person = Person()
    assert person.obey(lambda curl: synthetic_hand(curl, scale, thumb=thumb)).done
    result = person.wizard.result()
    (remark,) = result.remarks
    assert remark.startswith("The thumb moves by only")
    assert abs(np.diff(result.values["thumb_human"])[0]) > 0.85 * MIN_RANGE_DEG
    assert (mapped(result, synthetic_hand(0.0, scale, thumb=thumb)) <= 0.05).all()
    closed = mapped(result, synthetic_hand(1.0, scale, thumb=thumb))
    assert (closed[:2] >= 0.95).all()
    assert 100.0 * closed[2] <= percent_of(remark) + 1e-6 and closed[2] < 0.4


@given(st.floats(0.0, 0.1), st.floats(-0.06, 0.06))
@settings(max_examples=5)
def test_a_finger_that_hardly_moved_closes_the_robots_finger_only_so_far(moved, differs):
    """Only the index closes: of the two others a small motion is no grip, and the remark is true of both closings."""
    person, ways = Person(), (moved, max(0.0, moved + differs))

    def hand(curl, most):
        other, index = synthetic_hand(min(curl, most)), synthetic_hand(curl).fingers
        points = dataclasses.replace(other.fingers, index_tip=index.index_tip, index_bone=index.index_bone)
        return dataclasses.replace(other, fingers=points)

    for most in ways:
        person.obey(lambda curl, most=most: hand(curl, most), repetitions=1)
    assert person.wizard.done
    result = person.wizard.result()
    remarks = {remark.split()[1]: remark for remark in result.remarks if "moves by only" in remark}
    assert max(ways) > 0.05 or remarks.keys() == {"middle", "thumb"}
    for finger, remark in remarks.items():
        i = FINGERS.index(finger)
        assert max(mapped(result, hand(1.0, most))[i] for most in ways) <= percent_of(remark) / 100.0 + 1e-6
        opened, closed = result.values[f"{finger}_human"]
        assert opened - closed > 0.85 * 45.0, "13 deg more than was shown do not close the robot's finger"


@given(st.floats(0.005, 0.1))
@settings(max_examples=10)
def test_a_phase_lasts_until_the_hand_was_still_for_the_whole_time(period):
    person, elapsed = Person(), 0.0
    while person.wizard.look(person.now).progress == 0.0:
        person.number, person.now = person.number + 1, person.now + period
        person.wizard.step(TrackingFrame(person.number, 0.0, (synthetic_hand(),)), person.now)
        elapsed += period
    assert HOLD_S <= elapsed - period + 1e-9 <= HOLD_S + period + 1e-6


def test_a_tracker_that_starts_again_begins_the_phase_anew():
    person = Person()
    person.show(synthetic_hand(), seconds=0.8 * HOLD_S)
    person.number = 0
    assert person.show(synthetic_hand(), seconds=0.8 * HOLD_S).progress == 0.0
    assert person.show(synthetic_hand(), seconds=0.4 * HOLD_S).progress == 0.25


@pytest.mark.parametrize("apart", [30.0, 50.0])
def test_fingers_that_are_apart_leave_the_spread_at_its_default(apart):
    def hand(curl):
        shown, turn = synthetic_hand(curl), math.radians(apart)
        side = math.cos(turn) * shown.direction + math.sin(turn) * np.cross(shown.normal, shown.direction)
        ends = {"middle_bone": shown.palm + 0.06 * shown.direction, "index_bone": shown.palm + 0.06 * side}
        return dataclasses.replace(shown, fingers=dataclasses.replace(shown.fingers, **ends))

    person = Person()
    assert person.obey(hand).done
    result = person.wizard.result()
    assert ("spread_human" in result.values) == (apart == 30.0)
    assert [remark for remark in result.remarks if "deg apart" in remark] == (
        [] if apart == 30.0 else [f"The fingers were {apart:.0f} deg apart: the spread keeps its default."]
    )


@given(st.integers(0, 1000))
@settings(max_examples=4)
def test_outliers_and_short_gaps_change_nothing(seed):
    rng, person = np.random.default_rng(seed), Person()
    for curl in (0.0, 1.0) * 2:
        for _ in range(75):
            draw = rng.random()
            hand = synthetic_hand(curl if draw > 0.05 else round(rng.random(), 1))
            person.show(*([hand] if draw < 0.95 else []), seconds=0.02)
    assert person.wizard.done
    quiet = Person()
    quiet.obey(synthetic_hand)
    for key, value in quiet.wizard.result().values.items():
        np.testing.assert_allclose(person.wizard.result().values[key], value, atol=0.2)


@pytest.mark.parametrize(
    "shown, hint",
    [
        ((), "sees no hand"),
        ((synthetic_hand(), synthetic_hand(side="left")), "two hands"),
        ((dataclasses.replace(synthetic_hand(), fingers=None),), "all five fingers"),
        ((dataclasses.replace(synthetic_hand(), confidence=0.1),), "unsure of the hand"),
        ((dataclasses.replace(synthetic_hand(), confidence=float("nan")),), "unsure of the hand"),
        ((synthetic_hand(scale=0.35),), "mm from the palm's centre"),
        ((synthetic_hand(scale=1.8),), "mm from the palm's centre"),
        ((synthetic_hand(1.0),), "Open your hand further"),
        ((dataclasses.replace(synthetic_hand(), normal=[float("nan")] * 3),), "invalid numbers"),
    ],
)
def test_what_is_no_open_hand_is_refused_with_a_sentence(shown, hint):
    person = Person()
    step = person.show(*shown, seconds=3.0)
    assert hint in step.hint and step.progress == 0.0 and step.instruction == INSTRUCTIONS[OPEN]
    assert person.obey(synthetic_hand).done, "then it continues"


def test_the_other_hand_does_not_continue():
    person = Person()
    person.show(synthetic_hand())
    assert "continue with the right one" in person.show(synthetic_hand(1.0, side="left")).hint


def test_an_open_hand_is_not_taken_for_a_closed_one():
    person = Person()
    assert person.show(synthetic_hand(), seconds=10.0).hint == "Close your hand further."


def test_a_moving_hand_ends_no_phase():
    person = Person()
    for turn in np.linspace(0.0, 60.0, 300):
        step = person.show(synthetic_hand(0.25 + 0.25 * np.sin(turn)), seconds=0.02)
    assert step.hint == "Hold still for a moment." and step.progress == 0.0


@pytest.mark.parametrize("age", [1.0, -1.0])
def test_old_frames_count_as_silence(age):
    step = Person().show(synthetic_hand(), seconds=2.0, age=age)
    assert "stamps of the tracking frames" in step.hint and step.progress == 0.0


def test_a_silent_leap_is_named():
    person = Person()
    person.show(synthetic_hand(), seconds=0.3)
    assert "is the Leap running?" in person.wizard.look(person.now + 1.0).hint


def test_repetitions_that_differ_come_again_and_at_last_are_refused():
    person = Person()
    for most in (0.2, 1.0, 1.0):
        person.obey(lambda curl, most=most: synthetic_hand(most * curl), repetitions=1)
    assert person.wizard.done, "the third agrees with the second"
    assert (mapped(person.wizard.result(), synthetic_hand(1.0))[:3] >= 0.95).all()
    person = Person()
    for most in (0.2, 0.7, 0.2, 0.7):
        person.obey(lambda curl, most=most: synthetic_hand(most * curl), repetitions=1)
    assert not person.wizard.done and "closed hands differ" in person.wizard.failed
