"""Flexion, mapping and the pure chain of the hand."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from common.config import parse
from common.operator_rows import OLD_ROWS_S
from common.rotations import rotation_from_zyx
from leap_hand.config import HandConfig
from leap_hand.flexion import angle_between, flexion, map_angles
from leap_hand.teleop import GripperState, HandTeleop
from leap_motion.frames import FingerPoints, TrackedHand, TrackingFrame

SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_hand.yaml").read_text())
CONFIG = parse(HandConfig, SHIPPED, "leap_hand/")
OPEN_POSE = [0.0, 0.0, 0.0, 0.0]

angle = st.floats(0.0, math.pi)
anywhere = st.floats(-math.pi, math.pi)


def hand_with(alpha=90.0, beta=90.0, gamma=90.0, delta=10.0):
    """A right hand with the given angles [deg]: normal down, index and middle ahead, the thumb to the side."""

    def tip(angle, ahead):
        angle = math.radians(angle)
        return 0.09 * (math.cos(angle) * np.array([0.0, -1.0, 0.0]) + math.sin(angle) * np.array(ahead))

    half = math.radians(delta) / 2.0
    fingers = FingerPoints(
        index_tip=tip(alpha, (0.0, 0.0, -1.0)),
        middle_tip=tip(beta, (0.2, 0.0, -math.sqrt(0.96))),
        thumb_tip=tip(gamma, (-1.0, 0.0, 0.0)),
        index_bone=0.07 * np.array([-math.sin(half), 0.0, -math.cos(half)]),
        middle_bone=0.08 * np.array([math.sin(half), 0.0, -math.cos(half)]),
    )
    return TrackedHand(7, False, np.zeros(3), [0.0, 0.0, -1.0], [0.0, -1.0, 0.0], 1.0, fingers)


def flexion_of(hand):
    return flexion(hand.palm, hand.normal, hand.fingers)


def moved(hand, R, shift):
    """The same hand elsewhere."""
    points = {field.name: R @ getattr(hand.fingers, field.name) + shift for field in dataclasses.fields(FingerPoints)}
    return dataclasses.replace(hand, palm=R @ hand.palm + shift, normal=R @ hand.normal, fingers=FingerPoints(**points))


def changed(hand, field, value):
    """The same hand with another value of a field of its own or of its fingers."""
    if hasattr(hand, field):
        return dataclasses.replace(hand, **{field: value})
    return dataclasses.replace(hand, fingers=dataclasses.replace(hand.fingers, **{field: value}))


class Player:
    """Feeds hands to a HandTeleop as frames of a tracker at 100 Hz."""

    def __init__(self, hand_only=True, **changes):
        self.teleop = HandTeleop(dataclasses.replace(CONFIG, **changes), hand_only)
        self.number = 0
        self.now = 50.0

    def step(self, *hands):
        self.number += 1
        self.now += 0.01
        return self.teleop.step(TrackingFrame(self.number, 0.0, hands), self.now)

    def steps(self, count, *hands):
        return [self.step(*hands) for _ in range(count)]


@given(*[st.floats(5.0, 175.0)] * 3, st.floats(1.0, 90.0))
def test_flexion_gives_back_the_angles_of_the_hand(alpha, beta, gamma, delta):
    np.testing.assert_allclose(
        np.degrees(flexion_of(hand_with(alpha, beta, gamma, delta))), [alpha, beta, gamma, delta]
    )


@given(*[st.floats(20.0, 120.0)] * 3, anywhere, st.floats(-1.5, 1.5), anywhere, *[st.floats(-0.5, 0.5)] * 3)
def test_flexion_depends_neither_on_place_nor_attitude_nor_side(alpha, beta, gamma, a, b, c, x, y, z):
    hand = hand_with(alpha, beta, gamma)
    elsewhere = moved(hand, rotation_from_zyx(a, b, c), np.array([x, y, z]))
    mirrored = moved(hand, np.diag([-1.0, 1.0, 1.0]), np.zeros(3))
    np.testing.assert_allclose(flexion_of(elsewhere), flexion_of(hand), atol=1e-9)
    np.testing.assert_allclose(flexion_of(mirrored), flexion_of(hand), atol=1e-12)


@pytest.mark.parametrize("field", ["index_tip", "normal", "palm", "middle_bone"])
@pytest.mark.parametrize("bad", [(float("nan"), 0.0, 0.0), (0.0, float("inf"), 0.0)])
def test_flexion_refuses_numbers_that_are_not_finite(field, bad):
    with pytest.raises(ValueError):
        flexion_of(changed(hand_with(), field, bad))


def test_a_point_in_the_palm_centre_has_no_direction():
    with pytest.raises(ValueError):
        angle_between((0.0, 1.0, 0.0), (0.0, 1e-6, 0.0))


def test_the_shipped_limits_are_those_of_the_reference():
    np.testing.assert_allclose(np.degrees(CONFIG.human), [[85, 40], [85, 40], [85, 40], [25, 40]])
    np.testing.assert_allclose(np.degrees(CONFIG.robot), [[0, 115], [0, 115], [0, 100], [0, 40]])


@given(st.lists(angle, min_size=4, max_size=4))
def test_commands_stay_within_the_limits(angles):
    command = map_angles(np.array(angles), CONFIG.human, CONFIG.robot)
    assert np.all(command >= CONFIG.robot.min(axis=1)) and np.all(command <= CONFIG.robot.max(axis=1))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_commands_are_linear_between_the_limits_and_meet_them(share):
    angles = CONFIG.human[:, 0] + share * (CONFIG.human[:, 1] - CONFIG.human[:, 0])
    np.testing.assert_allclose(
        map_angles(angles, CONFIG.human, CONFIG.robot),
        CONFIG.robot[:, 0] + share * (CONFIG.robot[:, 1] - CONFIG.robot[:, 0]),
        atol=1e-12,
    )


def test_open_and_closed_hands():
    play = Player()
    result = play.step(hand_with(90.0, 90.0, 90.0, 10.0))
    assert (result.state, result.reason) == (GripperState.FOLLOWING, "right hand 7 is followed")
    np.testing.assert_allclose(result.command, OPEN_POSE, atol=1e-12)
    closed = play.step(hand_with(20.0, 20.0, 20.0, 10.0)).command
    np.testing.assert_allclose(closed, np.radians([115, 115, 100, 0]), atol=1e-12)
    np.testing.assert_allclose(play.step(hand_with(delta=50.0)).command, np.radians([0, 0, 0, 40]), atol=1e-12)


@pytest.mark.hazard(18)
@pytest.mark.parametrize(
    "hands, word", [((), "no hand"), ((dataclasses.replace(hand_with(), fingers=None),), "five fingers")]
)
@pytest.mark.parametrize("hold", [0.2, 1.0])
def test_without_a_whole_hand_the_grip_is_kept_for_a_while_then_the_robot_hand_opens(hands, word, hold):
    play = Player(grip_hold=hold)
    play.step(hand_with(20.0, 20.0, 20.0))
    kept = play.steps(round(hold * 100) - 1, *hands)
    assert all((r.state, r.command) == (GripperState.KEEPING, None) and word in r.reason for r in kept)
    result = play.steps(2, *hands)[-1]
    assert result.state == GripperState.OPEN and word in result.reason
    np.testing.assert_array_equal(result.command, OPEN_POSE)
    assert (play.teleop.counts.grips_kept, play.teleop.counts.grips_opened) == (1, 1)


def test_without_a_grip_hold_the_hand_opens_at_once():
    play = Player(grip_hold=0.0)
    play.step(hand_with(20.0, 20.0, 20.0))
    assert play.step().state == GripperState.OPEN


@pytest.mark.hazard(18)
@given(*[st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3)] * 2, st.booleans(), st.booleans())
def test_each_finger_keeps_its_grip_after_the_clutch_until_the_operators_comes_near(held, after, clutched, off):
    """From any grip to any other: within 15 % of its range it follows, and then for good."""

    def bent(*shares):
        return hand_with(*(85.0 - 45.0 * np.array(shares)), delta=25.0)

    play, scale = Player(hand_only=False), CONFIG.robot[:3, 1]
    play.teleop.switch(True)
    play.teleop.steered_by((7, False), play.now, keep_grip=clutched)
    play.step(bent(*held))
    play.teleop.steered_by(None, play.now, keep_grip=clutched)
    play.steps(5, bent(*after))
    if off:
        play.teleop.switch(False)
        play.teleop.switch(True)
    play.teleop.steered_by((7, False), play.now, keep_grip=clutched)
    for _ in range(2):
        command = play.step(bent(*after)).command[:3] / scale
        for h, a, c in zip(held, after, command):
            if abs(abs(h - a) - 0.15) > 1e-6:
                assert c == pytest.approx(h if clutched and not off and abs(h - a) > 0.15 else a, abs=1e-6)
    play.step(bent(*held))
    np.testing.assert_allclose(play.step(bent(*after)).command[:3] / scale, after, atol=1e-6)


def test_the_hand_alone_ignores_what_the_arm_does():
    play = Player(hand_only=True)
    play.teleop.steered_by(None, play.now)
    assert play.step(hand_with(20.0)).state == GripperState.FOLLOWING


def test_nothing_is_sent_before_the_gripper_flag_came():
    play = Player(hand_only=False)
    result = play.step(hand_with(20.0))
    assert (result.state, result.reason, result.command) == (
        GripperState.WAITING,
        "waiting for kuka/gripper_control",
        None,
    )
    assert play.teleop.silence(play.now + 10.0) is None
    assert play.teleop.switch(True) is None
    assert play.step(hand_with(20.0)).state == GripperState.FOLLOWING


@pytest.mark.parametrize("hand_only", [True, False])
def test_switching_the_gripper_off_opens_at_once_and_keeps_open(hand_only):
    play = Player(hand_only)
    play.teleop.switch(True)
    play.step(hand_with(20.0))
    result = play.teleop.switch(False)
    assert result.state == GripperState.OPEN
    np.testing.assert_array_equal(result.command, OPEN_POSE)
    assert play.teleop.switch(False) is None
    np.testing.assert_array_equal(play.step(hand_with(20.0)).command, OPEN_POSE)
    play.teleop.switch(True)
    assert play.step(hand_with(20.0)).state == GripperState.FOLLOWING


def test_torn_frames_do_not_let_go_as_long_as_the_grip_is_kept():
    play = Player()
    play.step(hand_with(20.0))
    torn = changed(hand_with(20.0), "index_tip", (float("nan"), 0.0, 0.0))
    results = play.steps(22, torn)
    assert all(r.command is None for r in results[:18])
    assert results[-1].state == GripperState.OPEN and "invalid numbers" in results[-1].reason
    assert play.step(hand_with(20.0)).state == GripperState.FOLLOWING
    assert play.step(torn).command is None


def test_a_silent_tracker_opens_the_hand_once():
    play = Player()
    play.step(hand_with(20.0))
    assert play.teleop.silence(play.now + 0.5) is None
    result = play.teleop.silence(play.now + 0.51)
    assert (result.state, result.reason) == (GripperState.OPEN, "no tracking frames come in")
    np.testing.assert_array_equal(result.command, OPEN_POSE)
    assert play.teleop.silence(play.now + 0.6) is None
    play.now += 1.0
    assert play.step(hand_with(20.0)).state == GripperState.FOLLOWING
    assert play.teleop.silence(play.now + 0.51) is not None


def test_a_silent_tracker_does_not_cut_a_longer_grip_short():
    play = Player(grip_hold=2.0)
    play.step(hand_with(20.0))
    assert play.teleop.silence(play.now + 1.9).state == GripperState.KEEPING
    assert play.teleop.silence(play.now + 2.1).state == GripperState.OPEN
    assert play.teleop.silence(play.now + 2.2) is None


def test_a_silent_leap_kuka_keeps_no_grip():
    play = Player(hand_only=False)
    play.teleop.switch(True)
    play.teleop.steered_by((7, False), play.now, keep_grip=True)
    play.step(hand_with(20.0, 20.0, 20.0))
    assert play.steps(140)[-1].state == GripperState.KEEPING
    assert play.steps(20)[-1].state == GripperState.OPEN


def test_a_grip_that_was_kept_for_a_moment_ends_the_following_of_a_hand_without_an_engagement():
    """Also where the report came and went between two frames: the hand that moved the fingers comes in anew."""
    play = Player(hand_only=False)
    play.teleop.switch(True)
    play.steps(30)
    assert play.steps(30, hand_with(60.0, 60.0, 60.0))[-1].state == GripperState.FOLLOWING
    play.teleop.steered_by(None, play.now)
    assert play.step(hand_with(60.0, 60.0, 60.0)).state == GripperState.FOLLOWING
    play.teleop.steered_by(None, play.now, keep_grip=True)
    play.teleop.steered_by(None, play.now)
    assert play.step(hand_with(20.0, 20.0, 20.0)).state == GripperState.KEEPING


def led(**changes) -> Player:
    """A robot hand whose arm a program steers."""
    player = Player(hand_only=False, **changes)
    player.teleop.switch(True)
    player.step()
    player.teleop.steered_by(None, player.now, keep_grip=True, led=True)
    return player


@pytest.mark.parametrize("frames", [0, 30])
def test_a_program_moves_the_fingers_and_a_hand_takes_them_over_where_they_are(frames):
    player = led(fingers_follow="steering")
    command = np.radians([60.0, 70.0, 50.0, 20.0])
    found = player.teleop.lead(command, player.now)
    np.testing.assert_allclose(found.command, command)
    assert all(result.command is None for result in player.steps(frames)), "they stay"
    hand = hand_with(84.0, 84.0, 84.0)
    for _ in range(5):
        player.teleop.steered_by((hand.id, hand.is_left), player.now)
        result = player.step(hand)
    np.testing.assert_allclose(result.command[:3], command[:3], err_msg="until the operator's come near")
    assert player.teleop.lead(0.0 * command, player.now) is None, "a hand steers"


def test_a_programs_command_stays_within_the_mapping():
    player = led()
    low, high = np.sort(CONFIG.robot, axis=1).T
    np.testing.assert_allclose(player.teleop.lead(np.full(4, 9.0), player.now).command, high)
    np.testing.assert_allclose(player.teleop.lead(np.full(4, -9.0), player.now).command, low)


def test_no_program_moves_the_fingers_of_a_gripper_that_is_off_or_of_an_arm_that_says_nothing():
    player = led()
    player.teleop.switch(False)
    assert player.teleop.lead(np.zeros(4), player.now) is None
    player = led()
    assert player.teleop.lead(np.zeros(4), player.now + OLD_ROWS_S + 0.01) is None
    assert player.teleop.lead(np.zeros(4), player.now) is not None
    player.teleop.steered_by(None, player.now, keep_grip=True)
    assert player.teleop.lead(np.zeros(4), player.now) is None


def test_a_grip_stays_until_a_programs_fingers_come_near_it():
    """A program that begins with an open hand lets nothing fall."""
    player = led()
    grip = np.radians([60.0, 70.0, 50.0, 20.0])
    player.teleop.lead(grip, player.now)
    player.teleop.steered_by(None, player.now, keep_grip=True)
    player.steps(30)
    player.teleop.steered_by(None, player.now, keep_grip=True, led=True)
    for _ in range(3):
        np.testing.assert_allclose(player.teleop.lead(np.zeros(4), player.now).command, grip)
    np.testing.assert_allclose(player.teleop.lead(grip, player.now).command, grip)
    np.testing.assert_allclose(player.teleop.lead(np.zeros(4), player.now).command, 0.0, atol=1e-12)


def test_fingers_that_a_program_has_moved_follow_its_next_command_however_far():
    player = led()
    for command in (np.zeros(4), np.radians([90.0, 90.0, 80.0, 30.0]), np.zeros(4)):
        player.step()
        player.teleop.steered_by(None, player.now, keep_grip=True, led=True)
        np.testing.assert_allclose(player.teleop.lead(command, player.now).command, command)
