"""The person who picks an object up, against an arm that follows the palm with a lag and a wrong scale."""

from __future__ import annotations

import numpy as np
import pytest
from following_rig import CENTER_LINE, PERIOD_S, PLAN, TOP, FollowingRig
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.rotations import rotation_about
from rig_simulation.operator.pick_and_place import PICK, STEPS, TAKE_OVER, PickAndPlace, PickView
from rig_simulation.operator.steering import FARTHEST_M, UP


def work(rig, seconds=120.0, following=lambda now: True, wanted=None, approach=-UP, tools=None):
    """Lets the person work; `wanted` is the heading that the object wants, None a round one; `tools` gets where the
    tool is at the beginning of each step."""
    person, steps, tools = PickAndPlace(PLAN, CENTER_LINE), [], {} if tools is None else tools
    for k in range(int(seconds / PERIOD_S)):
        now = k * PERIOD_S
        turn = 0.0 if wanted is None else wanted - rig.heading
        result = person.step(PickView(rig.tool, rig.top, rig.top[2] - TOP[2], following(now), turn, approach), now)
        if not steps or steps[-1] != result.step:
            steps.append(result.step)
            tools[result.step] = rig.tool - rig.top
        if result.move is not None:
            rig.make(result.move)
        if result.over:
            return result, steps
        rig.advance()
    pytest.fail(f"not over after {seconds} s: {steps}")


@settings(max_examples=25)
@given(st.floats(0.6, 1.1), st.floats(0.05, 0.4), st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))
def test_the_object_is_lifted_and_put_down_where_it_stood(scale, lag, dx, dy):
    top = TOP + np.array([dx, dy, 0.0])
    rig = FollowingRig(scale, lag, top)
    result, steps = work(rig)
    assert not result.failure and tuple(steps) == STEPS
    lifted = rig.highest - top[2]
    assert PLAN.lift - 2 * PLAN.tolerance < lifted < max(1.0, scale) * PLAN.lift + 2 * PLAN.tolerance
    assert_allclose(rig.top, top, atol=3 * PLAN.tolerance)
    assert rig.tool[2] - rig.top[2] > PLAN.clearance - 2 * PLAN.tolerance
    assert set(rig.curls) == {0.0, 1.0} and rig.curl == 0.0


@settings(max_examples=10)
@given(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7))
def test_a_tilted_hand_comes_and_leaves_along_its_approach(pitch, roll):
    approach = rotation_about(0, roll) @ rotation_about(1, pitch) @ -UP
    tools = {}
    result, steps = work(FollowingRig(), approach=approach, tools=tools)
    assert not result.failure and tuple(steps) == STEPS
    assert_allclose(tools["down"], -PLAN.clearance * approach, atol=2 * PLAN.tolerance)
    assert_allclose(tools["close"], -PLAN.grasp_height * approach, atol=2 * PLAN.tolerance)
    assert_allclose(tools["done"] - tools["away"], -PLAN.clearance * approach, atol=3 * PLAN.tolerance)


def test_nothing_moves_while_the_arm_does_not_follow():
    rig = FollowingRig()
    result, steps = work(rig, following=lambda now: False)
    assert "did not follow within 30 s" in result.failure and steps == ["wait"]
    assert not rig.curls


def test_an_arm_that_stops_on_the_way_is_given_up_with_the_reason():
    rig = FollowingRig()
    rig.advance = lambda: None
    result, _ = work(rig)
    assert "'above'" in result.failure


def test_a_hand_goes_no_farther_than_it_is_seen_after_an_arm_that_does_not_come():
    rig, palms = FollowingRig(), []
    rig.advance = lambda: None
    rig.make = lambda move: palms.append(move.palm)
    result, _ = work(rig)
    assert "mm off the target" in result.failure
    assert np.abs(palms).max() == FARTHEST_M


def test_who_rises_from_the_edge_of_what_the_arm_reaches_lets_it_stay_there():
    """Higher up it reaches less far."""
    rig, steps = FollowingRig(), []
    advance = rig.advance

    def reaching_less():
        advance()
        rig.tool[0] = min(rig.tool[0], TOP[0] + 0.03 - 0.5 * max(0.0, rig.tool[2] - rig.top[2] - 0.1))

    rig.advance = reaching_less
    rig.tool = rig.top + np.array([0.02, 0.0, 0.08])
    rig.come_in(CENTER_LINE)
    operator = PickAndPlace(PLAN, CENTER_LINE, TAKE_OVER)
    for k in range(round(40.0 / PERIOD_S)):
        result = operator.step(PickView(rig.tool, rig.top, 0.0), k * PERIOD_S)
        assert not result.failure
        steps.append(result.step)
        if result.move is not None:
            rig.make(result.move)
        rig.advance()
    assert "above" in steps


def test_a_person_waits_out_an_interruption():
    result, steps = work(FollowingRig(), following=lambda now: not 5.0 < now < 12.0)
    assert not result.failure and steps[-1] == "done"


@settings(max_examples=15)
@given(st.floats(-PLAN.most_turn, PLAN.most_turn), st.floats(0.6, 1.1))
def test_the_hand_turns_until_the_fingers_fit(wanted, scale):
    rig = FollowingRig(scale)
    result, _ = work(rig, wanted=wanted)
    assert not result.failure
    assert abs(rig.heading - wanted) < PLAN.turn_tolerance + 0.01


def test_a_hand_turns_no_further_than_the_arm_follows():
    rig = FollowingRig()
    result, steps = work(rig, wanted=1.0)
    assert not result.failure and steps[-1] == "done"
    assert abs(rig.yaw + PLAN.most_turn) < 1e-9


def test_a_pick_alone_ends_with_the_object_held_up():
    rig, steps = FollowingRig(), []
    person = PickAndPlace(PLAN, CENTER_LINE, PICK)
    for k in range(1200):
        result = person.step(PickView(rig.tool, rig.top, rig.top[2] - TOP[2]), k * PERIOD_S)
        steps += [] if result.step in steps else [result.step]
        if result.move is not None:
            rig.make(result.move)
        if result.over:
            break
        rig.advance()
    assert tuple(steps) == PICK and not result.failure
    assert rig.curl == 1.0 and rig.top[2] - TOP[2] > PLAN.lift - 2 * PLAN.tolerance
