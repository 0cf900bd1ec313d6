"""One hand steers the arm that it chooses, by a request or by its region; the other arm holds its tool."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from relative_rig import Rig

from common.errors import ConfigError
from common.poses import pose
from leap_kuka.arm_choice import BOTH, NOBODY, ArmChoice, elsewhere, meaning
from leap_kuka.numbers import CLEARLY_M
from leap_kuka.start_gate import CHOSEN
from leap_kuka.teleop_result import StreamState
from leap_kuka.tool_hold import HoldState

BOXES = {"left": -0.16, "right": 0.16}
T_HOME = pose(np.diag([-1.0, 1.0, -1.0]), (0.5, -0.3, 0.45))


def hand_at(x, number=1, left=False):
    return SimpleNamespace(id=number, is_left=left, palm=np.array([x, 0.35, 0.0]))


def test_by_service_both_arms_are_steered_until_one_is_chosen():
    choice = ArmChoice("service", BOXES)
    assert choice.chosen == BOTH
    answer = choice.request("left")
    assert answer.success and choice.chosen == "left" and answer.sentence == meaning("left")
    answer = choice.request("middle")
    assert not answer.success and choice.chosen == "left"
    assert "the arm is 'middle', but must be left, right or both" in answer.sentence
    assert not choice.see([hand_at(0.3)]) and choice.chosen == "left", "the place of the hand plays no role"
    assert choice.request(BOTH).success and choice.chosen == BOTH


def test_by_region_nobody_is_steered_before_a_hand_comes_and_requests_are_refused():
    choice = ArmChoice("region", BOXES)
    assert choice.chosen == NOBODY and not choice.see([])
    answer = choice.request("left")
    assert not answer.success and choice.chosen == NOBODY and "the region" in answer.sentence
    assert choice.see([hand_at(0.01)]) and choice.chosen == "right"
    assert not choice.see([]) and choice.chosen == "right", "a hand that leaves changes nothing"


@given(st.lists(st.floats(-0.4, 0.4), min_size=1, max_size=30))
def test_the_region_changes_only_where_the_hand_is_clearly_beyond_the_border(path):
    choice, before = ArmChoice("region", BOXES), NOBODY
    for x in path:
        changed = choice.see([hand_at(x)])
        assert changed == (choice.chosen != before)
        if before != NOBODY:
            side = 1.0 if before == "right" else -1.0
            assert changed == (side * x < -CLEARLY_M)
        before = choice.chosen


def test_the_hand_that_was_there_first_chooses_and_its_damaged_number_does_not():
    choice = ArmChoice("region", BOXES)
    choice.see([hand_at(-0.2)])
    assert not choice.see([hand_at(0.3, 2), hand_at(-0.1, 1)]) and choice.chosen == "left"
    assert not choice.see([hand_at(np.nan)]) and choice.chosen == "left"
    assert choice.see([hand_at(0.3, 2)]) and choice.chosen == "right"


def test_regions_need_boxes_apart():
    with pytest.raises(ConfigError, match="too near to each other: left 0 m, right 0.05 m"):
        ArmChoice("region", {"left": 0.0, "right": 0.05})
    ArmChoice("service", {"left": 0.0, "right": 0.0})


@pytest.mark.parametrize(
    ("chosen", "steered"), [("left", {"left"}), ("right", {"right"}), (BOTH, {"left", "right"}), (NOBODY, set())]
)
def test_who_is_not_chosen_knows_why(chosen, steered):
    assert {arm for arm in BOXES if elsewhere(chosen, arm) is None} == steered
    assert all(elsewhere(chosen, arm) for arm in set(BOXES) - steered) and meaning(chosen).endswith(".")


@pytest.mark.parametrize("changes", [{"engagement": "absolute"}, {"hold_time": 0.0}])
def test_a_choice_needs_arms_that_can_hold(leap, changes):
    settings = {"engagement": "relative", "hold_time": 30.0, "arm_choice": "service", **changes}
    (fault,) = leap(**settings).faults()
    assert "arm_choice is service, but needs the engagement relative and a hold_time" in fault
    assert not leap(**{**settings, "engagement": "relative", "hold_time": 30.0}).faults()


class TwoArms:
    """Two teleoperations over one tracker, each with its arm; the choice is handed to both."""

    def __init__(self, leap, arm, sample, how="service"):
        self.choice = ArmChoice(how, BOXES)
        switches = {"clutch": "none", "enabling": "none", "arm_choice": how, "hold_time": 5.0}
        self.rigs = {
            side: Rig(leap, arm, sample, T_HOME, hand=side, box_offset=x, **switches) for side, x in BOXES.items()
        }
        self.tell()

    def tell(self):
        for side, rig in self.rigs.items():
            rig.teleop.choose(elsewhere(self.choice.chosen, side), self.choice.chosen != BOTH)

    def choose(self, arm):
        assert self.choice.request(arm).success
        self.tell()

    def steps(self, count, *hands):
        for _ in range(count):
            if self.choice.see(hands):
                self.tell()
            for rig in self.rigs.values():
                rig.step(*hands)
        return {side: rig.results[-1] for side, rig in self.rigs.items()}

    def tools(self):
        return {side: rig.T_arm[:3, 3].copy() for side, rig in self.rigs.items()}


@pytest.fixture
def two(leap, arm, sample):
    return lambda how="service": TwoArms(leap, arm, sample, how)


def test_one_hand_steers_the_chosen_arm_and_the_other_holds_its_tool(two, sample):
    """The same right hand: at the right arm, then at the left one, which it may steer when that is chosen."""
    play = two()
    play.choose("right")
    results = play.steps(15, sample(position=(0.16, 0.35, 0.0)))
    assert results["right"].state is StreamState.RUNNING and results["left"].state is StreamState.WAITING
    assert CHOSEN in results["left"].unmet and play.rigs["left"].mode == "home"
    results = play.steps(40, sample(position=(0.16, 0.40, 0.0)))
    assert play.tools()["right"][2] - T_HOME[2, 3] == pytest.approx(0.05, abs=5e-3)
    play.choose("left")
    before = play.tools()
    for x in np.linspace(0.16, -0.16, 100):
        play.steps(1, sample(position=(x, 0.40, 0.0)))
    results = play.steps(30, sample(position=(-0.16, 0.40, 0.0)))
    assert results["left"].state is StreamState.RUNNING, results["left"].reason
    assert results["right"].hold is HoldState.KEPT and results["right"].keep_grip
    assert "the hand steers the left arm" in results["right"].reason
    np.testing.assert_allclose(play.tools()["right"], before["right"], atol=1e-9)
    play.steps(60, sample(position=(-0.16, 0.35, 0.0)))
    np.testing.assert_allclose(play.tools()["right"], before["right"], atol=1e-9, err_msg="longer than hold_time, too")
    assert play.tools()["left"][2] - T_HOME[2, 3] == pytest.approx(-0.05, abs=5e-3)
    assert play.rigs["right"].mode == "servo"


def test_an_arm_that_is_not_chosen_holds_longer_than_hold_time_and_continues_where_the_hand_is(two, sample):
    play = two()
    play.choose("right")
    play.steps(15, sample(position=(0.16, 0.35, 0.0)))
    play.choose("left")
    held = play.tools()["right"]
    play.steps(800, sample(position=(0.10, 0.35, 0.0)))
    np.testing.assert_allclose(play.tools()["right"], held, atol=1e-9)
    play.choose("right")
    results = play.steps(5, sample(position=(0.10, 0.35, 0.0)))
    assert results["right"].state is StreamState.RUNNING, results["right"].reason
    np.testing.assert_allclose(play.tools()["right"], held, atol=1e-9, err_msg="no jump at the return")
    play.steps(60, sample(position=(0.10, 0.38, 0.0)))
    assert play.tools()["right"][2] - held[2] == pytest.approx(0.03, abs=5e-3)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["left", "right"]), st.floats(-0.3, 0.3), st.floats(0.3, 0.4)), max_size=6))
def test_whatever_is_chosen_at_most_that_arm_moves_and_no_tool_jumps(leap, arm, sample, plan):
    play, at = TwoArms(leap, arm, sample), (0.16, 0.35)
    play.choose("right")
    play.steps(15, sample(position=(*at, 0.0)))
    for chosen, x, y in plan:
        play.choose(chosen)
        other = "left" if chosen == "right" else "right"
        held, before = play.tools()[other], play.tools()[chosen]
        for share in np.linspace(0.0, 1.0, 80):
            place = (at[0] + share * (x - at[0]), at[1] + share * (y - at[1]), 0.0)
            play.steps(1, sample(position=place))
            now = play.tools()[chosen]
            assert np.linalg.norm(now - before) < 0.02
            before = now
        at = x, y
        np.testing.assert_allclose(play.tools()[other], held, atol=1e-9)
