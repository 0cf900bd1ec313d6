"""The tool waits at a pose for a hand, and the hand takes it over from there."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.mounting import mounting_frame
from common.poses import inverse, pose
from common.rotations import rotation_about, rotation_angle
from leap_kuka.numbers import FADE_S
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_kuka.tool_hold import HoldState
from leap_motion.frames import TrackingFrame

DOWN = mounting_frame((1.0, -1.0, 0.0)).R_base_tool
BOX_HEIGHT = 0.35
level = st.floats(-19.0, 19.0)
in_box = st.floats(-0.09, 0.09)
place = st.tuples(st.floats(0.2, 0.6), st.floats(-0.6, -0.2), st.floats(0.2, 0.6))


def tool(x=0.45, y=-0.35, z=0.3, turn=0.0, tilt=0.0):
    """A tool that points down, turned about the vertical and tilted [deg]."""
    R = DOWN @ rotation_about(2, math.radians(turn)) @ rotation_about(1, math.radians(tilt))
    return pose(R, (x, y, z))


def in_base(result):
    return result.T_base_virtual @ result.T_virtual_tool


@pytest.fixture(scope="session")
def holding(leap, arm, player, sample):
    """Makes a player whose tool is held."""

    def make(T=None, duration=30.0):
        play = player(ArmTeleop(leap(), arm()))
        play.step()
        play.teleop.control(False)
        play.teleop.control(True)
        play.steps(3, sample(position=(0.3, BOX_HEIGHT, 0.0)))  # the hand comes in while control is on
        play.step()
        answer = play.teleop.hold(tool() if T is None else T, duration, play.now)
        assert answer.success, answer.sentence
        return play

    return make


def test_the_tool_is_held_with_every_frame_until_the_time_is_over(holding):
    play = holding(duration=0.5)
    results = play.steps(49)
    assert all((r.state, r.hold, r.usable) == (StreamState.WAITING, HoldState.HELD, True) for r in results)
    for result in results:
        np.testing.assert_allclose(in_base(result), tool(), atol=1e-12)
    over = play.steps(2)[-1]
    assert (over.hold, over.T_virtual_tool) == (HoldState.NONE, None)
    assert over.reason == "the tool is no longer held: no hand took it over in time"
    assert play.step().reason == "no hand is seen"


@settings(max_examples=30)
@given(place, st.floats(-180.0, 180.0), st.floats(-49.0, 49.0), st.floats(-180.0, 180.0), level, level, in_box, in_box)
def test_a_hand_begins_exactly_where_the_tool_is_held(holding, sample, p, turn, tilt, yaw, pitch, roll, x, z):
    """Whatever its place in the box, its heading and its tilt; and later its own attitude counts as ever, from the
    tool's own tilt on."""
    T = tool(*p, turn, tilt)
    play = holding(T)
    hand = sample(yaw, pitch, roll, position=(x, BOX_HEIGHT, z))
    results = play.steps(10, hand)
    assert [r.hold for r in results] == [HoldState.HELD] * 9 + [HoldState.TAKEN]
    np.testing.assert_allclose(in_base(results[-1]), T, atol=1e-9)
    results += play.steps(round(100 * FADE_S) + 2, hand)
    for before, after in zip(results, results[1:]):
        np.testing.assert_allclose(in_base(after)[:3, 3], T[:3, 3], atol=1e-12)
        assert rotation_angle(in_base(before)[:3, :3].T @ in_base(after)[:3, :3]) < math.radians(1.0)
    level_hand = play.steps(10, sample(yaw, position=(x, BOX_HEIGHT, z)))[-1]
    np.testing.assert_allclose(in_base(level_hand)[:3, :3], T[:3, :3], atol=1e-9)


@settings(max_examples=20)
@given(st.floats(-180.0, 180.0), *[st.floats(-0.05, 0.05)] * 3, *[st.floats(-30.0, 30.0)] * 3)
def test_the_tool_then_moves_as_without_a_hold_but_for_its_heading(
    leap, arm, player, holding, sample, turn, x, y, z, yaw, pitch, roll
):
    """What is ahead of the hand is ahead of the tool."""
    held, free = holding(tool(turn=turn)), player(ArmTeleop(leap(), arm()))
    hand = sample(yaw, pitch, roll, position=(x, BOX_HEIGHT + y, z))
    starts, ends = [], []
    for play in (held, free):
        starts.append(in_base(play.steps(10, sample())[-1]))
        ends.append(in_base(play.steps(round(100 * FADE_S) + 10, hand)[-1]))
    heading = (starts[0] @ inverse(starts[1]))[:3, :3]
    np.testing.assert_allclose(heading[2], [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(ends[0][:3, 3] - starts[0][:3, 3], heading @ (ends[1] - starts[1])[:3, 3], atol=1e-9)
    np.testing.assert_allclose(ends[0][:3, :3], heading @ ends[1][:3, :3], atol=1e-9)


def test_the_hand_that_took_over_steers_for_as_long_as_it_is_there(holding, sample):
    play = holding(duration=0.2)
    assert [r.hold for r in play.steps(100, sample())][9:] == [HoldState.TAKEN] * 91
    assert play.teleop.end_hold().sentence == "The tool is not held."
    assert play.step(sample()).state == StreamState.RUNNING


def test_afterwards_a_stream_begins_where_it_always_does(leap, arm, player, holding, sample):
    held, free = holding(), player(ArmTeleop(leap(), arm()))
    held.steps(20, sample())
    lost = held.steps(22)[-1]
    assert (lost.state, lost.hold, lost.T_virtual_tool) == (StreamState.WAITING, HoldState.NONE, None)
    hand = sample(yaw=20.0, position=(0.03, BOX_HEIGHT, 0.02))
    again, first = held.come_in(hand)[-1], free.come_in(hand)[-1]
    assert (again.state, again.hold) == (StreamState.RUNNING, HoldState.NONE)
    np.testing.assert_array_equal(again.T_base_virtual, first.T_base_virtual)
    np.testing.assert_array_equal(again.T_virtual_tool, first.T_virtual_tool)


def frozen(play):
    frame = TrackingFrame(play.number, 0.0, ())
    for _ in range(30):
        play.now += 0.01
        play.teleop.step(frame, play.now)


@pytest.mark.parametrize(
    "happens, reason",
    [
        (lambda play: play.teleop.control(False), "control of the arm is off"),
        (lambda play: play.teleop.end_hold(), "it was ended"),
        (lambda play: play.teleop.silence(play.now + 0.3), "no tracking frames come in"),
    ],
)
def test_what_ends_a_hold(holding, happens, reason):
    play = holding()
    assert play.step().hold == HoldState.HELD
    said = happens(play)
    result = play.step()
    assert (result.hold, result.T_virtual_tool) == (HoldState.NONE, None)
    assert f"the tool is no longer held: {reason}" in (result.reason, getattr(said, "reason", None))


def test_a_tracker_that_hangs_or_begins_anew_ends_a_hold(holding):
    hangs, anew, late = holding(), holding(), holding()
    frozen(hangs)
    assert hangs.teleop.silence(hangs.now).hold == HoldState.NONE
    anew.steps(5)
    anew.number = 0
    assert "the tool is no longer held: the tracker's frame number went back" in anew.step().reason
    assert "no tracking frame came for 0.3 s" in late.step(dt=0.3).reason


@pytest.mark.parametrize(
    "T, duration, sentence",
    [
        (tool(), -1.0, "the duration is -1 s and must be above 0 and at most 120 s"),
        (tool(), 121.0, "the duration is 121 s"),
        (tool(x=math.inf), 10.0, "finite numbers"),
        (2.0 * tool(), 10.0, "the last row of a pose"),
        (pose(2.0 * DOWN), 10.0, "not orthonormal"),
        (tool(tilt=51.0), 10.0, "the tool is tilted by 51.0 deg and must point down within 50 deg"),
        (tool(tilt=180.0), 10.0, "the tool is tilted by 180.0 deg"),
    ],
)
def test_what_cannot_be_held(leap, arm, player, T, duration, sentence):
    play = player(ArmTeleop(leap(), arm()))
    play.teleop.control(True)
    play.step()
    answer = play.teleop.hold(T, duration, play.now)
    assert not answer.success and sentence in answer.sentence
    assert play.step().T_virtual_tool is None and play.teleop.counts.holds == 0


def test_when_nothing_can_be_held(leap, arm, player, sample):
    play = player(ArmTeleop(leap(), arm()))

    def refusal():
        answer = play.teleop.hold(tool(), 10.0, play.now)
        assert not answer.success
        return answer.sentence

    assert refusal() == "The tool is not held: no tracking frames come in."
    play.step()
    assert refusal() == "The tool is not held: control of the arm is off."
    play.teleop.control(False)
    play.teleop.control(True)
    play.come_in(sample())
    assert refusal() == "The tool is not held: a hand is followed."
    play.steps(22)
    assert play.teleop.hold(tool(), 10.0, play.now).success
    assert "it is held already" in refusal()
    assert play.teleop.end_hold().success and play.teleop.end_hold().success
