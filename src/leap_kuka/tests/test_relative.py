"""Relative engagement: the tool starts where it is, follows the changes of the hand, and stays for the next hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from relative_rig import BOX_HEIGHT, HOLD_S, Rig

from common.poses import pose
from common.reasons import ReasonCode
from common.rotations import rotation_angle, rotation_from_zyx
from leap_kuka.kept_tool import no_measured_tool
from leap_kuka.start_gate import CONDITIONS, ENABLED, RATE, READY, RELEASED
from leap_kuka.teleop_result import StreamState
from leap_kuka.tool_hold import HoldState

angle = st.floats(-180.0, 180.0)
level = st.floats(-19.0, 19.0)
offset = st.floats(-0.09, 0.09)
scale = st.sampled_from([0.5, 1.0, 2.0])
FORWARD, LEFT = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]) / math.sqrt(2.0)
home = st.builds(
    lambda p, a, b, c: pose(rotation_from_zyx(*np.radians([a, b, c])), p[0] * FORWARD + p[1] * LEFT + [0.0, 0.0, p[2]]),
    *[st.tuples(st.floats(0.5, 0.7), st.floats(-0.7, 0.7), st.floats(0.4, 0.7)), angle, st.floats(-80.0, 80.0), angle],
)


@pytest.fixture(scope="session")
def rig(leap, arm, sample):
    """Makes a Rig; by default the arm is at home with a tool that points down."""
    T = pose(np.diag([-1.0, 1.0, -1.0]), (0.5, -0.3, 0.45))
    return lambda T_home=T, scale=1.0, **changes: Rig(leap, arm, sample, T_home, scale, **changes)


@given(home, scale, st.floats(-180.0, 180.0), level, level, offset, offset)
def test_the_tool_does_not_move_when_a_hand_engages(rig, sample, T_home, scale, yaw, pitch, roll, x, z):
    """Whatever the tool's pose, the hand's and the scaling factor; and it stays while the hand does."""
    play = rig(T_home, scale)
    hand = sample(yaw, pitch, roll, position=(x, BOX_HEIGHT, z))
    play.engaged(hand)
    play.steps(20, hand)
    np.testing.assert_allclose(play.T_arm, T_home, atol=1e-9)


@settings(max_examples=25)
@given(home, scale, angle, level, level, *[st.floats(-0.1, 0.1)] * 3, *[st.floats(-24.0, 24.0)] * 3)
def test_the_tool_makes_the_motion_of_the_hand(rig, sample, T_home, scale, yaw, pitch, roll, x, y, z, a, b, c):
    """Forward is along the centre line, whatever the hand's heading; turns are about the same axes in space."""
    play = rig(T_home, scale)
    hand = sample(yaw, pitch, roll)
    play.engaged(hand)
    R_start = np.column_stack([hand.direction, np.cross(hand.normal, hand.direction), hand.normal])
    R_end = R_start @ rotation_from_zyx(*np.radians([a, b, c]))
    ends = sample(position=(x, BOX_HEIGHT + y, z))
    moved = type(ends)(12, False, ends.palm, R_end[:, 0], R_end[:, 2], 1.0)
    for share in np.linspace(0.0, 1.0, 40):
        R = R_start @ rotation_from_zyx(*(share * np.radians([a, b, c])))
        way = (share * x, BOX_HEIGHT + share * y, share * z)
        play.step(type(ends)(12, False, way, R[:, 0], R[:, 2], 1.0))
    result = play.steps(30, moved)
    R_base_leap = result.T_base_virtual[:3, :3]
    np.testing.assert_allclose(R_base_leap @ [0, 1, 0], [0, 0, 1], atol=1e-9)
    psi = math.atan2(hand.direction[0], -hand.direction[2])
    forward = R_base_leap @ [math.sin(psi), 0.0, -math.cos(psi)]
    np.testing.assert_allclose(forward, np.array([1.0, -1.0, 0.0]) / math.sqrt(2.0), atol=1e-9)
    shift = scale * R_base_leap @ [x, y, z]
    np.testing.assert_allclose(play.T_arm[:3, 3] - T_home[:3, 3], shift, atol=1e-9)
    turn = R_base_leap @ R_end @ R_start.T @ R_base_leap.T
    np.testing.assert_allclose(play.T_arm[:3, :3], turn @ T_home[:3, :3], atol=1e-6)


def test_each_angle_is_clipped_and_counts_from_the_start(rig, sample):
    play = rig().engaged(sample(pitch=15.0))
    for pitch in range(15, 80):
        result = play.steps(3, sample(pitch=float(pitch)))
    assert result.limits == ("pitch",) and math.degrees(result.clipped.pitch) == pytest.approx(25.0)
    assert rotation_angle(play.T_home[:3, :3].T @ play.T_arm[:3, :3]) == pytest.approx(math.radians(25.0))


@pytest.mark.parametrize("stop", [{"clutched": True}, {"enabled": False}])
def test_a_hand_works_its_way_by_the_clutch(rig, sample, stop):
    """The same hand continues, wherever and however it is held, and the tool travels farther than the hand."""
    play = rig(hold_time=60.0).engaged(sample())
    for _ in range(4):
        for x in np.linspace(0.0, 0.3, 60):
            play.step(sample(position=(x, BOX_HEIGHT, 0.0), roll=100.0 * x))
        play.steps(20, sample(position=(0.3, BOX_HEIGHT, 0.0), roll=30.0))
        before = play.T_arm
        play.device(**stop)
        for x in np.linspace(0.3, 0.0, 60):
            result = play.step(sample(position=(x, BOX_HEIGHT, 0.0), roll=100.0 * x))
            assert (result.state, result.hold, result.owner) == (StreamState.WAITING, HoldState.KEPT, None)
            np.testing.assert_allclose(play.T_arm, before, atol=1e-9)
        play.steps(12, sample())
        play.device(enabled=True, clutched=False)
        result = play.steps(20, sample())
        assert result.state is StreamState.RUNNING
        np.testing.assert_allclose(play.T_arm, before, atol=1e-9)
    assert np.linalg.norm(play.T_arm[:3, 3] - play.T_home[:3, 3]) == pytest.approx(1.2)
    assert play.teleop.counts.kept == 4 and play.teleop.counts.clutched == 4 * ("clutched" in stop)


@pytest.mark.hazard(21)
def test_a_fast_hand_does_not_go_on_until_it_is_slow(rig, sample):
    play = rig(hold_time=60.0).engaged(sample())
    play.device(clutched=True)
    for x in np.linspace(0.01, 0.6, 60):
        play.device(clutched=x < 0.2)
        result = play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
    assert result.hold is HoldState.KEPT and "too fast" in result.reason
    assert play.steps(20, sample(position=(0.6, BOX_HEIGHT, 0.0))).state is StreamState.RUNNING


def test_while_the_arm_is_not_ready_the_tool_stays_wherever_the_hand_was_when_the_tracker_got_slow(rig, sample):
    play = rig(hold_time=60.0).engaged(sample())
    play.steps(60, sample())
    for i in range(30):
        play.step(sample(position=(0.002 * i, BOX_HEIGHT, 0.0)), dt=0.06)
    assert "frames per second" in play.results[-1].obstacle
    play.mode = "pick_up"
    before = play.T_arm
    for x in np.linspace(0.06, 0.1, 40):
        result = play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
        assert result.state is StreamState.RUNNING and "once the arm is ready" in result.reason
        np.testing.assert_allclose(result.T_base_virtual @ result.T_virtual_tool, before, atol=1e-9)


@pytest.mark.parametrize("loss", ["lost", "confidence"])
def test_the_hold_ends_and_the_arm_goes_home(rig, sample, loss):
    play = rig().engaged(sample())
    away = () if loss == "lost" else (sample(confidence=0.0),)
    frames = [play.step(*away) for _ in range(300)]
    held = [frame.hold is HoldState.KEPT for frame in frames]
    assert 200 <= sum(held) <= 202 and not any(held[-20:]) and frames[-1].T_virtual_tool is None
    assert any("no hand took it over in time" in frame.reason for frame in frames)
    assert play.steps(100).T_virtual_tool is None and play.mode == "home"
    assert play.steps(30, sample()).state is StreamState.WAITING, "the hand must come in"


@pytest.mark.parametrize(
    ("stop", "code"),
    [
        (lambda play: play.device(clutched=True), ReasonCode.CLUTCHED),
        (lambda play: play.device(enabled=False), ReasonCode.NOT_ENABLED),
        (lambda play: play.teleop.choose("another arm is steered", False), ReasonCode.ELSEWHERE),
    ],
)
def test_the_code_of_an_end_names_what_the_operator_did(rig, sample, stop, code):
    play = rig(hold_time=0.0).engaged(sample())
    stop(play)
    result = play.step(sample())
    assert (result.state, result.codes) == (StreamState.WAITING, (code,)), result.reason


@pytest.mark.parametrize("stop", [{"clutched": True}, {"enabled": False}])
@pytest.mark.parametrize("seen", [True, False])
def test_the_hold_does_not_end_while_the_operator_stops_the_tool(rig, sample, stop, seen):
    play = rig().engaged(sample())
    play.device(**stop)
    result = play.steps(300, *[sample()] * seen)
    assert (result.hold, result.hold_left, play.mode) == (HoldState.KEPT, HOLD_S, "servo")
    play.device(enabled=True, clutched=False)
    assert play.steps(100).hold is HoldState.KEPT
    assert play.steps(110).hold is HoldState.NONE


def tool_sent(play, result):
    T = result.T_base_virtual @ result.T_virtual_tool
    return play.centre + play.scale * (T[:3, 3] - play.centre)


@pytest.mark.parametrize("mode", ["servo", "pick_up"])
@pytest.mark.parametrize("behind, shift", [(0.04, 0.0), (0.1, 0.05), (0.149, 0.099), (0.16, 0.0)])
def test_the_kept_tool_glides_to_where_an_arm_that_is_behind_can_stop(rig, sample, behind, shift, mode):
    """It never jumps, and the measured tool moves it by no more than this, wherever that goes afterwards."""
    play = rig(scale=2.0, hold_time=60.0).engaged(sample())
    play.steps(3, sample())
    wanted, play._follow, play.mode = play.T_arm, lambda *_: None, mode
    play.T_arm = pose(p=(0.0, 0.0, behind)) @ wanted
    play.device(clutched=True)
    heights = []
    for _ in range(60):
        heights.append(tool_sent(play, play.step(sample()))[2] - wanted[2, 3])
        play.T_arm = pose(p=(0.0, 0.0, 0.002)) @ play.T_arm
    shift = shift if mode == "servo" else 0.0
    expected = np.minimum(0.3 * 0.01 * np.arange(60), shift)
    np.testing.assert_allclose(heights, expected, atol=1e-9)


@pytest.mark.parametrize("known, brakes", [(0.3, True), (0.7, False)])
def test_the_kept_tool_goes_with_an_arm_that_brakes_since_the_hand_jumped(rig, sample, known, brakes):
    """The controller finds it where the arm rests, so that no PTP motion follows."""
    play = rig(scale=1.0, hold_time=60.0).engaged(sample())
    play.steps(10, sample())
    arm, play._follow = play.T_arm, lambda *_: None
    for x in np.arange(0.0, 0.3, 0.015):
        play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
    play.steps(round(100 * (known - 0.2)), sample(position=(0.285, BOX_HEIGHT, 0.0)))
    wanted = tool_sent(play, play.results[-1])
    play.device(clutched=True)
    for z in [*np.linspace(0.0, 0.05, 20), *[0.05] * 60]:
        play.T_arm = pose(p=(0.0, 0.0, z)) @ arm
        p = tool_sent(play, play.step(sample(position=(0.285, BOX_HEIGHT, 0.0))))
        np.testing.assert_allclose(p, play.T_arm[:3, 3] if brakes else wanted, atol=1e-9)
    play.T_arm = pose(p=(0.0, 0.0, 0.09)) @ arm
    after = tool_sent(play, play.step(sample(position=(0.285, BOX_HEIGHT, 0.0))))
    np.testing.assert_allclose(after, p, atol=1e-9, err_msg="half a second after it was left")


@pytest.mark.parametrize("fault", ["far", "unknown", "scale"])
def test_a_measured_tool_or_scaling_that_cannot_be_true_moves_nothing(rig, sample, fault):
    play = rig(hold_time=60.0).engaged(sample())
    play.steps(10, sample())
    wanted, play._follow = tool_sent(play, play.results[-1]), lambda *_: None
    play.T_arm = pose(p=(0.1, 0.2, 0.1) if fault == "far" else (0.0, 0.0, 0.1)) @ play.T_arm
    play.device(clutched=True)
    if fault == "unknown":
        play.teleop._measured_tool = no_measured_tool
    for _ in range(60):
        play.scale = math.nan if fault == "scale" else 1.0
        result = play.step(sample())
        play.scale = 1.0
        np.testing.assert_allclose(tool_sent(play, result), wanted, atol=1e-9)


@pytest.mark.parametrize("end, words", [("off", "control of the arm is off"), ("stopped", "in the mode stopped")])
def test_why_an_engagement_ended_is_said(rig, sample, end, words):
    play = rig(hold_time=0.0, enabling="none", clutch="none").engaged(sample())
    play.steps(3, sample())
    play.control_on, play.mode = end != "off", "stopped" if end == "stopped" else "servo"
    play._follow = lambda *_: None
    assert words in play.step(sample()).reason


def test_an_arm_that_is_measured_away_from_home_starts_nothing(rig, sample):
    play = rig(enabling="none")
    play.T_arm = pose(p=(0.0, 0.1, 0.0)) @ play.T_home
    result = play.steps(30, sample())
    assert result.T_virtual_tool is None and "it is measured 100 mm from home" in result.reason


@pytest.mark.parametrize("mode", ["home", "pick_up"])
def test_the_desired_tool_waits_for_an_arm_that_does_not_servo_yet(rig, sample, mode):
    play = rig(enabling="none", clutch="none")
    follow, play._follow = play._follow, lambda *_: None
    play.steps(12, sample())
    play.mode = mode
    for x in np.linspace(0.0, 0.3, 60):
        result = play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
        np.testing.assert_allclose(result.T_base_virtual @ result.T_virtual_tool, play.T_home, atol=1e-9)
    assert result.state is StreamState.RUNNING and mode in result.obstacle and not result.follows
    play.mode, play._follow = "servo", follow
    play.steps(20, sample(position=(0.3, BOX_HEIGHT, 0.0)))
    for x in np.linspace(0.3, 0.4, 20):
        play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
    result = play.steps(20, sample(position=(0.4, BOX_HEIGHT, 0.0)))
    assert result.follows
    assert 0.09 < np.linalg.norm(play.T_arm[:3, 3] - play.T_home[:3, 3]) < 0.15


@pytest.mark.parametrize("filter", ["mean", "kalman", "one_euro"])
def test_a_hand_that_comes_back_elsewhere_continues_from_there(rig, sample, filter):
    play = rig(filter=filter).engaged(sample())
    play.steps(30, sample())
    before = play.T_arm
    play.steps(15)
    for _ in range(30):
        assert play.step(sample(position=(0.04, BOX_HEIGHT, 0.0))).state is StreamState.RUNNING
        np.testing.assert_allclose(play.T_arm, before, atol=1e-6)


def test_a_program_ends_no_kept_tool(rig, sample):
    play = rig().engaged(sample())
    play.device(clutched=True)
    play.step(sample())
    assert "not held" in play.teleop.end_hold().sentence
    assert play.step(sample()).hold is HoldState.KEPT


@pytest.mark.parametrize("loss", ["off", "silent"])
def test_a_first_start_needs_control_and_a_controller(rig, sample, loss):
    play = rig(enabling="none", clutch="none")
    play.teleop.control(True, "home", 1.0, play.now)
    assert READY not in play.step(sample()).unmet
    play.teleop.control(loss != "off", "home", 1.0, play.now)
    play.teleop.control = lambda *_: None
    play.now += 0.1 if loss == "off" else 1.5
    result = play.steps(20, sample())
    assert result.state is StreamState.WAITING and READY in result.unmet


def test_the_switches_have_their_state_while_the_tracker_is_silent(rig, sample):
    play = rig().engaged(sample())
    play.now += 0.5
    play.teleop.switches.device.take(False, True, "pedal", 0.0, play.now)
    silent = play.teleop.silence(play.now)
    assert (silent.enabled, silent.clutched, silent.source) == (False, True, "pedal")
    assert silent.unmet >= {ENABLED, RELEASED, RATE}


def test_a_hand_that_changes_its_side_is_no_second_hand(rig, sample):
    play = rig(enabling="none", clutch="second_hand_fist")
    play.steps(12, sample(grab=1.0))
    assert play.steps(3, sample(grab=1.0, is_left=True)).state is StreamState.RUNNING
    assert play.step(sample(grab=1.0)).state is StreamState.RUNNING


def test_what_was_kept_once_latches_no_later_second_hand(rig, sample):
    play = rig(enabling="none", clutch="second_hand_fist")
    play.steps(12, sample())
    fist = sample(id=20, is_left=True, position=(-0.2, 0.3, 0.0), grab=1.0)
    play.steps(5, sample(), fist)
    play.teleop.silence(play.now + 0.3)
    play.now += 1.0
    play.steps(3, fist)
    play.steps(5, sample(id=30, position=(0.0, BOX_HEIGHT, 0.3)))
    assert not play.steps(5, sample(id=30, position=(0.0, BOX_HEIGHT, 0.3))).clutched


def test_a_short_press_between_two_frames_clutches(rig, sample):
    play = rig().engaged(sample())
    play.teleop.switches.device.take(True, True, "pedal", 0.0, play.now)
    assert play.step(sample()).hold is HoldState.KEPT


@pytest.mark.parametrize("mode", ["stopped", "zero", "returning", "homing", None])
def test_a_fault_and_control_off_end_hold_and_stream_at_once(rig, sample, mode):
    for clutched in (True, False):
        play = rig(hold_time=60.0).engaged(sample())
        play.device(clutched=clutched)
        play.steps(3, sample())
        play.mode, play.control_on = mode or play.mode, mode is not None
        result = play.step(sample())
        assert (result.hold, result.T_virtual_tool) == (HoldState.NONE, None)


@pytest.mark.parametrize("device", ["enabling", "clutch"])
def test_a_device_that_falls_silent_stops_the_tool(rig, sample, device):
    changes = {"enabling": "none", "clutch": "none", device: "device"}
    play = rig(hold_time=60.0, **changes).engaged(sample())
    play.device_there = False
    play.steps(30, sample())
    before = play.T_arm
    for x in np.linspace(0.0, 0.1, 30):
        play.step(sample(position=(x, BOX_HEIGHT, 0.0)))
    np.testing.assert_allclose(play.T_arm, before, atol=1e-12)
    play.device_there = True
    assert play.steps(50, sample()).state is StreamState.WAITING, "not by itself"
    np.testing.assert_allclose(play.T_arm, before, atol=1e-12)


@pytest.mark.parametrize(
    "T, words",
    [
        (ValueError("the quaternion has norm 0 instead of 1"), "norm 0"),
        (pose(p=(math.nan, 0.0, 0.0)), "finite"),
        (2.0 * np.eye(4), "last row"),
        (pose(np.zeros((3, 3))), "not orthonormal"),
    ],
)
def test_a_bad_measurement_refuses_the_start(rig, sample, T, words):
    play = rig()

    def measured():
        if isinstance(T, ValueError):
            raise T
        return T

    play.teleop._measured_tool = measured
    play.device(enabled=True)
    result = play.steps(30, sample())
    assert result.T_virtual_tool is None and words in result.reason


@pytest.mark.parametrize("scale", [0.0, -1.0, math.nan, math.inf])
def test_an_unknown_scaling_factor_refuses_the_start(rig, sample, scale):
    play = rig(scale=scale, enabling="none")
    assert "scaling factor" in play.steps(30, sample()).reason


@pytest.mark.parametrize("mode", ["", "starting", "homing", "servo", "returning", "stopped"])
def test_the_first_start_is_at_home(rig, sample, mode):
    play = rig(enabling="none")
    play.mode = mode
    play.silent = -10.0  # the arm stays in this mode
    result = play.steps(30, sample())
    assert result.state is StreamState.WAITING and "not at home" in result.reason


def test_the_second_hands_fist_is_a_clutch(rig, sample):
    play = rig(enabling="none", clutch="second_hand_fist", hold_time=60.0)
    play.steps(12, sample())
    assert play.results[-1].state is StreamState.RUNNING
    fist = sample(id=20, is_left=True, position=(-0.2, 0.3, 0.0), grab=1.0)
    opened = sample(id=20, is_left=True, position=(-0.2, 0.3, 0.0), grab=0.1)
    assert play.step(sample(grab=1.0)).state is StreamState.RUNNING, "the hand that steers is not the clutch"
    assert play.step(sample(), opened).state is StreamState.RUNNING
    assert play.step(sample(), fist).hold is HoldState.KEPT
    assert play.steps(50, sample()).clutched, "a clutch hand that is lost keeps the tool"
    assert play.steps(5, sample(), opened).hold is HoldState.KEPT
    assert play.steps(20, sample(), opened).state is StreamState.RUNNING


def test_a_clutch_device_that_is_silent_lets_no_hand_start(rig, sample):
    play = rig(enabling="none")
    play.device_there = False
    play.steps(30)
    result = play.steps(30, sample())
    assert result.state is StreamState.WAITING and RELEASED in result.unmet
    assert "the clutch device is silent" in result.reason


def test_a_clutch_hand_that_leaves_with_the_hand_that_steered_keeps_the_next_one_waiting(rig, sample):
    play = rig(enabling="none", clutch="second_hand_fist", hold_time=60.0)
    play.steps(12, sample())
    fist, opened = (sample(id=20, is_left=True, position=(-0.2, 0.3, 0.0), grab=grab) for grab in (1.0, 0.0))
    play.step(sample(), fist)
    play.steps(50)
    play.steps(5, sample(id=13, position=(0.0, BOX_HEIGHT, 0.3)))
    result = play.steps(30, sample(id=13))
    assert result.hold is HoldState.KEPT and result.unmet == {RELEASED}
    assert play.steps(30, sample(id=13), opened).state is StreamState.RUNNING


def test_the_conditions_have_ticks(rig, sample):
    play = rig()
    play.device(enabled=False)
    assert play.steps(12, sample()).unmet >= {ENABLED}
    play.device(enabled=True, clutched=True)
    assert play.steps(2, sample()).unmet >= {RELEASED}
    assert play.steps(2, sample()).unmet <= set(CONDITIONS)
    play.step()
    assert "in the box" in play.steps(12, sample(position=(0.2, BOX_HEIGHT, 0.0))).unmet
    assert {"in the box", "slow", "came in"} <= play.steps(12).unmet
    assert play.engaged(sample()).results[-1].unmet == frozenset()


ACTIONS = st.one_of(
    st.tuples(st.just("move"), st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.tuples(*[st.floats(-60.0, 60.0)] * 3)),
    st.tuples(st.sampled_from(["wait", "away", "unsure", "in", "silence", "device away"]), st.integers(1, 60)),
    st.tuples(st.sampled_from(["clutch", "enable", "control", "number", "second fist", "gap"])),
    st.tuples(st.sampled_from(["in", "clutch"])),
)


@settings(max_examples=30, deadline=None)
@given(home, scale, st.sampled_from(["device", "second_hand_fist"]), st.lists(ACTIONS, min_size=3, max_size=14))
def test_the_tool_never_moves_farther_than_the_hand(rig, sample, T_home, scale, clutch, actions):
    """Between any two frames of any sequence of events; and it stands still unless the stream runs."""
    play = rig(T_home, scale, clutch=clutch)
    at = SimpleNamespace(p=np.array([0.0, BOX_HEIGHT, 0.0]), turn=np.zeros(3), id=12, fist=False)
    before = [None, play.T_arm]

    def frame(p=None, turn=None, seen=True, confidence=1.0, dt=0.01):
        at.p, at.turn = at.p if p is None else p, at.turn if turn is None else turn
        hands = [sample(*at.turn, position=at.p, id=at.id, confidence=confidence)] if seen else []
        if at.fist:
            hands.append(sample(id=99, is_left=True, position=(-0.3, 0.3, 0.0), grab=1.0))
        was_home = play.mode == "home"
        result = play.step(*hands, dt=dt)
        T_hand, T_arm = before[0], before[1]
        moved, turned = 0.0, 0.0
        if T_hand is not None and result.T_virtual_filtered is not None:
            moved = np.linalg.norm(result.T_virtual_filtered[:3, 3] - T_hand[:3, 3])
            turned = rotation_angle(T_hand[:3, :3].T @ result.T_virtual_filtered[:3, :3])
        runs = result.state is StreamState.RUNNING
        if result.T_virtual_tool is not None or was_home:
            step = np.linalg.norm(play.T_arm[:3, 3] - T_arm[:3, 3])
            assert step <= (scale * moved if runs else 0.0) + 1e-9
            assert rotation_angle(T_arm[:3, :3].T @ play.T_arm[:3, :3]) <= (3.0 * turned if runs else 0.0) + 1e-6
        if result.T_virtual_filtered is not None or not runs:
            before[0] = result.T_virtual_filtered
        before[1] = play.T_arm

    for action, *more in actions:
        if action == "move":
            starts, turns = at.p, at.turn
            count = 5 + int(np.linalg.norm(more[0]) / 0.01)
            for share in np.linspace(0.0, 1.0, count):
                frame(starts + share * np.array(more[0]), turns + share * (np.array(more[1]) - turns))
        elif action == "in":
            for _ in range(25):
                frame(seen=False)
            play.control_on = True
            play.device(enabled=False, clutched=False)
            at.fist = False
            for _ in range(5):
                frame(np.array([0.0, BOX_HEIGHT, 0.3]), np.zeros(3))
            play.device(enabled=True)
            for z in [*np.arange(0.29, 0.0, -0.01), *[0.0] * 25]:
                frame(np.array([0.0, BOX_HEIGHT, z]))
        elif action == "clutch":
            play.device(clutched=not play.clutched)
            frame()
        elif action == "enable":
            play.device(enabled=not play.pressed)
        elif action == "control":
            play.control_on = not play.control_on
        elif action == "number":
            at.id += 1
        elif action == "second fist":
            at.fist = not at.fist
        elif action == "gap":
            frame(dt=0.25)
        elif action == "silence":
            play.now += 0.01 * more[0]
            play.teleop.silence(play.now)
        else:
            play.device_there = action != "device away"
            for _ in range(more[0]):
                frame(seen=action != "away", confidence=0.0 if action == "unsure" else 1.0)
            play.device_there = True
