"""The whole pure chain of the arm: hands made by hand, and faults."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.reasons import ReasonCode
from common.rotations import rotation_about
from leap_kuka.teleop import ArmTeleop
from leap_kuka.teleop_result import StreamState
from leap_motion.frames import TrackedHand, TrackingFrame


@pytest.fixture
def play(leap, arm, player):
    """A ArmTeleop with the default parameters, fed by frames at 100 Hz."""
    return player(ArmTeleop(leap(), arm()))


def tool_in_base(result):
    return result.T_base_virtual @ result.T_virtual_tool


def test_a_level_hand_in_the_box_starts_when_the_window_is_full(play, sample):
    results = play.steps(10, sample())
    assert [r.state for r in results] == [StreamState.WAITING] * 9 + [StreamState.RUNNING]
    assert all(r.T_virtual_filtered is None for r in results[:9])
    assert results[0].reason == "right hand 12: 1 of 10 samples are in"
    assert results[-1].reason == "right hand 12 is followed"
    np.testing.assert_allclose(tool_in_base(results[-1])[:3, 3], [0.42, -0.42, 0.4], atol=1e-12)


@given(st.lists(st.tuples(*[st.floats(-40.0, 40.0)] * 3), min_size=1, max_size=25))
def test_the_measured_hand_is_that_of_each_frame_from_the_first_sample_on(leap, arm, player, sample, attitudes):
    play = player(ArmTeleop(leap(), arm()))
    for i, angles in enumerate(attitudes):
        hand = sample(*angles, position=(0.001 * i, 0.35, 0.0))
        result = play.step(hand)
        measured = result.T_virtual_hand[:3, [0, 2, 3]].T
        np.testing.assert_allclose(measured, [hand.direction, hand.normal, hand.palm], rtol=1e-7, atol=1e-12)
        assert (result.T_virtual_filtered is None) == (i < 9)


@pytest.mark.parametrize("position", [(np.nan, 0.35, 0.0), (0.0, 0.45, 0.0)])
def test_a_sample_that_is_left_out_is_no_measured_hand(play, sample, position):
    play.steps(10, sample())
    result = play.step(sample(position=position))
    assert result.T_virtual_hand is None and result.T_virtual_filtered is not None


@pytest.mark.parametrize(
    "hand, reason",
    [
        ({"position": (-0.132, 0.35, 0.0)}, "the palm is 32 mm left of the box"),
        ({"position": (0.15, 0.2, 0.0)}, "the palm is 50 mm right of and 50 mm below the box"),
        ({"position": (0.0, 0.46, -0.11)}, "the palm is 10 mm above and 10 mm behind the box"),
        ({"position": (0.0, 0.35, 0.11)}, "the palm is 10 mm in front of the box"),
        ({"pitch": 30.0}, "the pitch is 30.0 deg and must be within 20 deg"),
        ({"pitch": -21.0, "yaw": 90.0}, "the pitch is -21.0 deg and must be within 20 deg"),
        ({"roll": -34.0}, "the roll is -34.0 deg and must be within 20 deg"),
        ({"roll": 180.0}, "the roll is 180.0 deg and must be within 20 deg"),
        ({"confidence": 0.05}, "the confidence is 0.05 and must be above 0.05"),
    ],
)
def test_each_start_condition_is_asked_and_named(play, sample, hand, reason):
    result = play.steps(30, sample(**hand))[-1]
    assert (result.state, result.reason) == (StreamState.WAITING, f"right hand 12: {reason}")
    assert result.T_virtual_filtered is not None and result.T_virtual_tool is None


@pytest.mark.parametrize("speed", [0.4, 0.5, 1.0, 1.5])
@pytest.mark.parametrize("ahead", [(1.0, 0.0, 0.0), (0.0, -0.6, 0.8)])
@pytest.mark.parametrize("buffer_size", [1, 2, 10, 50])
def test_a_hand_that_flies_through_the_box_starts_nothing_until_it_rests_there(
    leap, arm, player, sample, speed, ahead, buffer_size
):
    play = player(ArmTeleop(leap(buffer_size=buffer_size), arm()))
    middle = np.array([0.0, 0.35, 0.0])
    results = [play.step(sample(position=middle + d * np.array(ahead))) for d in np.arange(-0.3, 0.3, 0.01 * speed)]
    assert all(r.state == StreamState.WAITING for r in results)
    if buffer_size <= 10:
        said = f"the hand moves too fast for a start, at {speed:.2f} m/s, and must be below 0.3 m/s"
        assert any(said in r.reason for r in results)
    results = [play.step(sample(position=middle + d * np.array(ahead))) for d in np.arange(0.3, 0.0, -0.01 * speed)]
    assert all(r.state == StreamState.WAITING for r in results)
    assert play.steps(max(buffer_size, 10), sample(position=middle))[-1].state == StreamState.RUNNING


def test_a_slow_hand_starts_and_a_fast_one_continues(play, sample):
    for step in range(9):
        play.step(sample(position=(-0.05 + 0.0025 * step, 0.35, 0.0)))
    assert play.step(sample(position=(-0.0275, 0.35, 0.0))).state == StreamState.RUNNING
    for step in range(10):
        assert play.step(sample(position=(-0.0275 + 0.015 * step, 0.35, 0.0))).state == StreamState.RUNNING


def test_frames_that_come_in_a_burst_tell_no_speed_that_lets_a_hand_start(play, sample):
    """What the tracker held up comes all at once; the hand moved while it did."""
    for step in range(10):
        result = play.step(sample(position=(0.01 * step - 0.05, 0.35, 0.0)), dt=1e-4)
    assert result.state == StreamState.WAITING and "too fast" in result.reason


def test_low_confidence_ends_a_stream_with_its_reason(play, sample):
    play.steps(10, sample())
    results = play.steps(12, sample(confidence=0.01))
    end = next(r for r in results if r.state == StreamState.WAITING)
    assert "confidence" in end.reason
    assert end.T_virtual_tool is None and end.T_virtual_filtered is not None
    rests = play.steps(30, sample())[-1]
    assert rests.state == StreamState.WAITING and "out of the box and back in" in rests.reason
    assert play.come_in(sample(position=(0.0, 0.35, 0.095)))[-1].state == StreamState.RUNNING


def test_a_hand_that_is_missing_stops_the_tool_at_once_and_ends_the_stream_after_200_ms(play, sample):
    play.steps(10, sample())
    missing = play.steps(20)
    assert all((r.state, r.owner) == (StreamState.RUNNING, (12, False)) for r in missing)
    assert all(r.T_virtual_tool is r.T_virtual_filtered is r.T_virtual_hand is None and r.obstacle for r in missing)
    result = play.step()
    assert (result.state, result.reason, result.owner) == (StreamState.WAITING, "right hand 12 was lost", None)
    assert result.codes == (ReasonCode.HAND_GONE,)
    assert play.step().reason == "no hand is seen"
    assert play.come_in(sample(id=13))[-1].state == StreamState.RUNNING


@pytest.mark.parametrize("wrong", [{"palm": (0.0, 3.0, 0.0)}, {"direction": (0.0, 0.0, -2.0)}])
def test_a_hand_whose_numbers_cannot_be_right_has_jumped_and_is_not_gone(play, sample, wrong):
    play.steps(10, sample())
    results = play.steps(10, dataclasses.replace(sample(), **{key: np.array(v) for key, v in wrong.items()}))
    ended = next(result for result in results if result.state is StreamState.WAITING)
    assert ended.reason.startswith("right hand 12 was lost: ") and ended.codes == (ReasonCode.HAND_JUMPED,)


@pytest.mark.parametrize("frames", [0, 1, 5, 19])
def test_after_missing_frames_the_same_hand_steers_on_from_where_it_was(play, sample, frames):
    before = play.steps(20, sample(yaw=10.0))[-1]
    play.steps(frames)
    results = play.steps(10, sample(yaw=10.0, id=12 + frames))
    assert all(r.state == StreamState.RUNNING and r.owner == (12 + frames, False) for r in results)
    for result in results:
        np.testing.assert_allclose(tool_in_base(result), tool_in_base(before), atol=1e-9)
    assert play.teleop.counts.streams == 1 and play.teleop.counts.id_changes == (frames > 0)


@pytest.mark.hazard(5)
@pytest.mark.parametrize(
    "other",
    [{"id": 13, "position": (0.05, 0.35, 0.0)}, {"is_left": True}, {"id": 13, "yaw": 25.0}, {"id": 13, "roll": 25.0}],
)
def test_another_hand_in_the_place_of_the_first_never_takes_over(play, sample, other):
    play.steps(10, sample())
    results = play.steps(300, sample(**other))
    assert all(r.T_virtual_tool is None for r in results)
    assert [r.state for r in results] == [StreamState.RUNNING] * 20 + [StreamState.WAITING] * 280
    assert results[20].reason == "right hand 12 was lost" and "out of the box and back in" in results[-1].reason
    assert results[20].codes == (ReasonCode.HAND_GONE,) and ReasonCode.IN_BOX_ALREADY in results[-1].codes


@pytest.mark.parametrize(("gap", "restarts", "starts"), [(0.5, False, True), (2.5, False, False), (0.05, True, False)])
def test_a_hand_that_came_in_has_come_in_though_no_frame_shows_it_for_a_moment(play, sample, gap, restarts, starts):
    play.steps(10, sample())
    play.steps(30)
    play.steps(5, sample(id=13, position=(0.0, 0.35, 0.2)))
    play.steps(10, sample(id=13, pitch=40.0))
    play.number *= not restarts
    play.step(sample(id=13), dt=gap)
    assert (play.steps(20, sample(id=13))[-1].state == StreamState.RUNNING) == starts


def test_control_that_goes_on_ends_a_stream_that_began_before(play, sample):
    play.teleop.control(False)
    assert play.come_in(sample())[-1].state == StreamState.RUNNING
    play.teleop.control(True)
    result = play.step(sample())
    assert result.state == StreamState.WAITING and "control of the arm was switched on" in result.reason
    assert play.steps(50, sample())[-1].state == StreamState.WAITING
    assert play.come_in(sample())[-1].state == StreamState.RUNNING


def test_no_stream_starts_where_the_arm_cannot_come(leap, arm, player, sample):
    """It is asked where everything else is met, for the tool frame that the stream would start with."""
    asked, answer = [], ["joint 4 would pass its limit"]
    play = player(ArmTeleop(leap(), arm(), lambda T, _: asked.append(T) or answer[0]))
    play.steps(20, sample(pitch=30.0))
    assert not asked
    result = play.steps(20, sample(yaw=40.0, pitch=10.0))[-1]
    assert result.state == StreamState.WAITING and result.reason == "right hand 12: joint 4 would pass its limit"
    answer[0] = None
    count = len(asked)
    started = play.step(sample(yaw=40.0, pitch=10.0))
    assert started.state == StreamState.RUNNING and len(asked) == count + 1
    np.testing.assert_allclose(asked[-1], tool_in_base(started), atol=1e-9)


def test_while_the_arm_cannot_come_a_stream_runs_on_and_says_so(leap, arm, player, sample):
    asked, answer = [], [None]
    play = player(ArmTeleop(leap(), arm(), lambda T, _: asked.append(T) or answer[0]))
    play.steps(10, sample())
    answer[0] = "joint 4 would pass its limit"
    results = play.steps(100, sample())
    assert all(r.state == StreamState.RUNNING and r.T_virtual_tool is not None for r in results)
    assert results[-1].obstacle == "right hand 12 is followed, but joint 4 would pass its limit"
    assert 5 <= len(asked) <= 6, "five times a second, and at the start"
    answer[0] = None
    assert play.steps(25, sample())[-1].obstacle is None


@pytest.mark.hazard(11)
@pytest.mark.parametrize("field", ["palm", "direction", "normal"])
def test_numbers_that_are_not_finite_never_go_on(play, sample, field):
    play.steps(10, sample())
    bad = dataclasses.replace(sample(), **{field: (0.0, float("nan"), 0.0)})
    results = play.steps(5, bad)
    assert all(r.T_virtual_tool is None or np.all(np.isfinite(r.T_virtual_tool)) for r in results)
    assert results[-1].state == StreamState.WAITING and "finite" in results[-1].reason


def test_a_repeated_frame_is_no_frame(play, sample):
    play.steps(10, sample())
    frozen = TrackingFrame(play.number, 0.0, (sample(),))
    assert not play.teleop.step(frozen, play.now + 0.1).usable
    assert play.teleop.silence(play.now + 0.15) is None
    silent = play.teleop.silence(play.now + 0.25)
    assert (silent.state, silent.reason, silent.usable) == (StreamState.WAITING, "the tracker repeats frame 10", False)
    assert play.steps(30, sample())[-1].state == StreamState.WAITING
    assert play.come_in(sample())[-1].state == StreamState.RUNNING


def test_below_20_frames_per_second_the_tool_stays(play, sample):
    play.steps(60, sample())
    results = [play.step(sample(position=(0.001 * i, 0.35, 0.0)), dt=0.06) for i in range(30)]
    tools = [tool_in_base(r)[:3, 3] for r in results]
    np.testing.assert_array_equal(np.diff(tools[15:], axis=0), 0.0)
    assert results[-1].state == StreamState.RUNNING
    assert "17 frames per second" in results[-1].obstacle and results[-1].reason.startswith(results[-1].obstacle)
    assert [play.step(sample(), dt=0.045).obstacle is None for _ in range(30)][-1] is False, "22 Hz are not enough"
    hand = sample(position=(0.015, 0.35, 0.0))
    assert play.steps(60, hand)[-1].obstacle is None and play.teleop.frame_rate == pytest.approx(100.0)
    moved = tool_in_base(play.step(hand))[:3, 3] - tools[-1]
    assert np.linalg.norm(moved) < 0.02 and play.teleop.counts.streams == 1


def test_a_hand_that_moved_while_the_tracker_was_slow_does_not_steer_on(play, sample):
    play.steps(60, sample())
    for i in range(30):
        play.step(sample(position=(0.002 * i, 0.35, 0.0)), dt=0.06)
    results = play.steps(60, sample(position=(0.058, 0.35, 0.0)))
    assert results[-1].state == StreamState.WAITING and any("moved while" in r.reason for r in results)


def test_a_hand_that_comes_after_a_slow_tracker_steers_from_where_it_is(play, sample):
    play.steps(60, sample())
    for _ in range(10):
        play.step(sample(), dt=0.06)
    assert "frames per second" in play.step(sample(), dt=0.06).obstacle
    play.steps(60)
    hand = sample(position=(0.06, 0.35, 0.0), id=13)
    results = play.come_in(hand)
    assert results[-1].state == StreamState.RUNNING and play.teleop.counts.streams == 2
    assert not any("moved while" in result.reason for result in results)
    tools = [tool_in_base(result)[:3, 3] for result in results if result.T_virtual_tool is not None]
    np.testing.assert_allclose(tools, [tools[-1]] * len(tools), atol=0.03)


def test_a_slow_tracker_starts_no_stream(play, sample):
    for _ in range(40):
        result = play.step(sample(), dt=0.055)
    assert result.state == StreamState.WAITING
    assert result.reason.endswith("the tracker delivers only 18 frames per second, and 24 are needed")


def test_a_tracker_that_started_again_ends_the_stream(play, sample):
    play.steps(10, sample())
    play.number = 2
    result = play.step(sample())
    assert result.state == StreamState.WAITING and "went back" in result.reason


@settings(max_examples=30)
@given(st.floats(-math.pi, math.pi), st.lists(st.tuples(*[st.floats(-40.0, 40.0)] * 3), min_size=1, max_size=15))
def test_turning_the_device_about_the_vertical_changes_nothing_in_the_base_frame(
    leap, arm, player, sample, turn, attitudes
):
    """The palm stays on the axis of the turn, where the box is the same for both."""
    still, turned = (player(ArmTeleop(leap(), arm())) for _ in range(2))
    R = rotation_about(1, turn)
    for angles in [(0.0, 0.0, 0.0)] * 10 + attitudes:
        hand = sample(*angles)
        results = still.step(hand), turned.step(rotated(hand, R))
    assert results[0].state == results[1].state == StreamState.RUNNING
    np.testing.assert_allclose(tool_in_base(results[0]), tool_in_base(results[1]), atol=1e-9)


@settings(max_examples=30)
@given(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-0.04, 0.04))
def test_a_left_hand_does_what_the_mirrored_right_hand_does(leap, arm, player, sample, yaw, pitch, roll, x):
    right, left = (player(ArmTeleop(leap(), arm())) for _ in range(2))
    right.steps(10, sample())
    left.steps(10, sample(is_left=True))
    r = right.steps(10, sample(yaw, pitch, roll, position=(x / 4, 0.35, 0.0)))[-1]
    mirrored = left.steps(10, sample(-yaw, pitch, -roll, position=(-x / 4, 0.35, 0.0), is_left=True))[-1]
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(
        mirrored.T_virtual_tool, mirror @ r.T_virtual_tool @ np.diag([1.0, -1.0, 1.0, 1.0]), atol=1e-9
    )


def rotated(hand, R):
    return TrackedHand(hand.id, hand.is_left, R @ hand.palm, R @ hand.direction, R @ hand.normal, hand.confidence)


@pytest.mark.parametrize("time_out", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("rate", [50.0, 110.0, 295.0])
@pytest.mark.parametrize("wait", [0.07, 0.12, 0.3])
def test_another_hand_never_continues_the_stream_of_desired_tools(leap, arm, player, sample, time_out, rate, wait):
    """The engagement ends at once; a second hand comes in fast. The controller must see a pause; with a long
    time-out the arm then goes to the new hand from where it is.
    """
    play = player(ArmTeleop(leap(), arm(time_out=time_out)))

    def other(x):
        return sample(id=20, is_left=True, yaw=20.0, position=(x, 0.35, 0.03))

    for _ in range(int(rate)):
        play.step(sample(), other(0.125), dt=1.0 / rate)
    for _ in range(int(rate)):
        if play.step(sample(confidence=0.0), other(0.125), dt=1.0 / rate).T_virtual_tool is None:
            break
        last = play.now
    ended, result = play.now, None
    while play.now - ended < 3.0 and (result is None or result.owner is None):
        x = max(0.085, 0.125 - 0.5 * max(0.0, play.now - ended - wait))
        result = play.step(sample(confidence=0.0), other(x), dt=1.0 / rate)
    assert result.owner == (20, True)
    assert 0.29 < play.now - last < 0.6


@pytest.mark.parametrize(
    "blocks",
    [
        {"position": (-0.101, 0.35, 0.02), "roll": 60.0},
        {"position": (-0.08, 0.35, 0.02), "roll": 60.0},
        {"position": (-0.08, 0.35, 0.02), "confidence": 0.0},
    ],
)
@pytest.mark.parametrize("seed", range(4))
def test_a_hand_that_cannot_start_blocks_no_other(play, sample, blocks, seed):
    """At the edge of the box, where noise brings it in and out, or in the box, tilted or hardly seen."""
    rng = np.random.default_rng(seed)

    def beside():
        hand = sample(id=3, is_left=True, **blocks)
        return dataclasses.replace(hand, palm=hand.palm + rng.normal(0.0, 0.002, 3))

    for _ in range(50):
        play.step(beside())
    assert any(play.step(beside(), sample()).owner == (12, False) for _ in range(90))


@pytest.mark.parametrize(
    ("axis", "far", "code"),
    [
        (0, -0.2, "left_of_box"), (0, 0.2, "right_of_box"), (1, -0.2, "below_box"), (1, 0.2, "above_box"),
        (2, -0.2, "behind_box"), (2, 0.2, "in_front_of_box"),
    ],
)  # fmt: skip
def test_a_reason_names_its_side_of_the_box_and_all_that_is_missing(play, sample, axis, far, code):
    position = [0.0, 0.35, 0.0]
    position[axis] += far
    result = play.steps(10, sample(position=position, roll=30.0, confidence=0.0))[-1]
    told = [c.value for c in result.codes if c is not ReasonCode.IN_BOX_ALREADY]
    assert told == [code, "not_level", "unsure"], result.reason


def test_without_any_confidence_no_stream_starts(leap, arm, player, sample):
    play = player(ArmTeleop(leap(min_confidence=0.0), arm()))
    assert play.steps(10, sample(confidence=0.0))[-1].state == StreamState.WAITING
