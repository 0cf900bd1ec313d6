"""The driver's state machine with a simulated hand, in virtual time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reflex.codec import IDLE, POSITION, VELOCITY, decode_state, encode_mode, encode_target
from reflex.hand import HandStatus
from reflex.reading import measure
from reflex.status import status
from rig_simulation.devices.reflex.hand import SimulatedHand

TRAVEL = (3.6, 3.6, 3.6, 1.75)
once = settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])


def angles(bench):
    return np.array(bench.reading.joint_angles)


def last_target(bench):
    return [p for p in bench.sent if p[0] == 2][-1]


def test_starts_and_stops_like_the_makers_driver(bench):
    b = bench()
    assert b.sent == [bytes.fromhex("0102020202")]
    assert b.driver.stop().send == (bytes.fromhex("0100000000"),)
    held = b.driver.stop(hold=True)
    assert held.send == () and "keep torque" in held.notes[0].text


def test_a_driver_that_holds_at_its_exit_ends_a_change_of_speed_in_which_torque_is_off(bench):
    b = bench()
    assert b.run(0.5, lambda: b.driver.motion.changing_speed)
    assert b.driver.stop(hold=True).send == (bytes.fromhex("0102020202"),)
    assert b.run(0.5, lambda: not b.driver.motion.changing_speed)
    assert b.driver.stop(hold=True).send == ()


def test_the_speed_is_set_when_the_hand_appears(bench):
    b = bench()
    b.run(0.3)
    assert b.sent[1:] == [
        bytes.fromhex("0101010101"),
        bytes.fromhex("02 0164 0564 0164 04fb"),
        bytes.fromhex("0102020202"),
        encode_target(b.reading.packet.positions),
    ]
    assert b.device.state()["torque"] == [True] * 4
    assert b.driver.state(b.now) is HandStatus.READY


@pytest.mark.parametrize("seed", range(5))
def test_calibrates_any_hand_and_moves_it_as_commanded(bench, seed):
    b = bench(seed).calibrated()
    goal = (2.0, 1.0, 1.8, 0.5)
    b.command(*goal)
    b.run(2.0)
    np.testing.assert_allclose(angles(b), goal, atol=0.01)
    np.testing.assert_allclose(b.device.state()["angles"], goal, atol=0.3)
    np.testing.assert_allclose(b.reading.proximal, b.device.state()["proximal"], atol=0.01)
    np.testing.assert_allclose(np.add(b.reading.proximal, b.reading.distal), angles(b)[:3], atol=0.01)
    b.command(0, 0, 0, 0)
    b.run(2.0)
    np.testing.assert_allclose(angles(b), 0, atol=0.01)
    np.testing.assert_allclose(b.reading.proximal, 0, atol=0.01)


@once
@given(goal=st.tuples(*[st.floats(-1e9, 1e9) for _ in range(4)]))
def test_a_goal_never_leaves_the_travel(bench, goal):
    b = bench().calibrated()
    before = len(b.sent)
    b.command(*goal)
    assert len(b.sent) == before + 1
    b.run(3.0)
    np.testing.assert_allclose(angles(b), np.clip(goal, 0, TRAVEL), atol=0.01)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_goal_that_is_not_finite_is_refused_and_the_last_one_stays(bench, bad):
    b = bench().calibrated()
    b.command(1, 1, 1, 0.5)
    before = list(b.sent)
    assert "finite" in b.command(0, bad, 0, 0).refusal
    b.run(2.0)
    assert b.sent == before
    np.testing.assert_allclose(angles(b), (1, 1, 1, 0.5), atol=0.01)


def test_nothing_moves_before_the_hand_is_heard(bench):
    b = bench()
    assert "not been heard" in b.command(1, 1, 1, 0).refusal
    assert "not been heard" in b.take(b.driver.set_speed((1, 1, 1, 1), b.now)).refusal
    assert b.driver.state(b.now) is HandStatus.WAITING
    assert len(b.sent) == 1


@pytest.mark.parametrize(
    ("calibrated", "sentence"), [(False, "never been calibrated"), (True, "f1 stands at -1.65 rad")]
)
def test_a_hand_without_its_own_calibration_refuses_commands(bench, calibrated, sentence):
    b = bench(calibrated=calibrated)
    b.run(0.3)
    before = b.device.state()["goals"]
    assert sentence in b.command(1, 1, 1, 0).refusal
    assert b.device.state()["goals"] == before


def test_commands_wait_for_the_end_of_a_calibration(bench):
    b = bench()
    b.run(0.3)
    b.take(b.driver.calibrate_fingers(b.now))
    b.run(0.1)
    assert b.driver.state(b.now) is HandStatus.CALIBRATING
    b.command(3.6, 3.6, 3.6, 1)
    b.command(1.0, 1.0, 1.0, 0.2)
    assert "being calibrated" in b.take(b.driver.command_raw((14000,) * 4, b.now)).refusal
    assert "being calibrated" in b.take(b.driver.set_speed((1,) * 4, b.now)).refusal
    assert "being calibrated" in b.take(b.driver.zero_pose(b.now)).refusal
    b.run(0.2)
    assert max(b.device.state()["angles"]) < 0.2
    b.run(4.0)
    np.testing.assert_allclose(angles(b), (1, 1, 1, 0.2), atol=0.01)


def test_a_request_is_followed_when_a_hand_comes_in_time_and_given_up_otherwise(bench):
    for wait, heard in ((2.0, True), (10.0, False)):
        b = bench()
        b.device.set_silent(True)
        b.take(b.driver.calibrate_fingers(b.now))
        b.run(wait)
        b.device.set_silent(False)
        b.run(3.0)
        assert (b.driver.calibration_outcome == "succeeded") == heard
        assert b.said("given up") != heard


@pytest.mark.parametrize(("above", "touched"), [(20, False), (21, True)])
def test_contact_is_strictly_above_the_threshold(shipped, above, touched):
    packet = decode_state(SimulatedHand(1).packet())
    counts = tuple(140 + above * (cell == 4) for cell in range(9))
    packet = replace(packet, pressures=(packet.pressures[0], counts, packet.pressures[2]))
    reading = measure(packet, *shipped, ((20,) * 9,) * 3)
    assert reading.pressure[1][4] == above
    assert reading.contact[1] == tuple(touched and cell == 4 for cell in range(9))
    angles = reading.joint_angles + reading.proximal + reading.distal + reading.loads
    assert {*map(type, angles)} == {float}, "numpy's own numbers print as np.float64(2.5)"


@pytest.mark.hazard(17)
def test_only_the_overloaded_finger_is_loosened(bench):
    """Reported in https://github.com/RightHandRobotics/reflex-ros-pkg/pull/6: the preshape motor overloads first.
    Tried: one overloaded motor.
    """
    b = bench().calibrated()
    b.command(2.0, 1.5, 1.8, 0.5)
    b.run(2.0)
    goals = b.device.state()["goals"]
    b.device.set_load(1, 500)
    b.run(0.2)
    now = b.device.state()["goals"]
    assert now[1] > goals[1], "f2 opens towards rising positions"
    assert [now[i] for i in (0, 2, 3)] == [goals[i] for i in (0, 2, 3)]
    assert b.said("f2 is overloaded")
    assert b.driver.motion.guard.overloaded == ("f2",)
    b.run(3.0)
    np.testing.assert_allclose(angles(b), (2.0, 0, 1.8, 0.5), atol=0.02)
    assert sum("overloaded" in note.text for note in b.notes) == 1


@pytest.mark.parametrize("motor", range(4))
def test_a_motor_overloaded_while_it_opens_turns_back_and_opens_no_further(bench, motor):
    b = bench().calibrated()
    b.command(1.5, 1.5, 1.5, 1.0)
    b.run(2.0)
    b.command(*(0.0 if i == motor else angle for i, angle in enumerate((1.5, 1.5, 1.5, 1.0))))
    b.run(0.1)
    opening = angles(b)
    assert 0.1 < opening[motor] < (1.5, 1.5, 1.5, 1.0)[motor] - 0.05, "on its way"
    b.device.set_load(motor, -900)
    b.run(0.3)
    turned = angles(b) - opening
    assert turned[motor] > 0.0
    np.testing.assert_allclose(np.delete(turned, motor), 0.0, atol=0.01)
    b.device.set_load(motor, None)
    still = angles(b)[motor]
    b.command(*(0.0 if i == motor else angle for i, angle in enumerate((1.5, 1.5, 1.5, 1.0))))
    b.run(1.0)
    assert angles(b)[motor] > still - 0.1, "the bound stays until a command turns back from it"


def test_after_an_overload_a_finger_closes_again_only_once_its_command_has_turned_back(bench):
    b = bench().calibrated()
    b.device.block(0, 0.5, 600.0)
    for _ in range(200):
        b.command(2.5, 1.0, 1.0, 0)
        b.run(0.025)
    held = angles(b)[0]
    assert held < 1.6
    assert b.driver.motion.guard.bounded == ("f1",)
    assert b.reading.distal[0] > b.reading.proximal[0]
    b.device.block(0, None)
    b.command(2.5, 1.0, 1.0, 0)
    b.run(1.0)
    assert angles(b)[0] == pytest.approx(held, abs=0.02)
    b.command(0.5, 1.0, 1.0, 0)
    b.run(1.0)
    b.command(2.5, 1.0, 1.0, 0)
    b.run(2.0)
    np.testing.assert_allclose(angles(b), (2.5, 1, 1, 0), atol=0.01)


@once
@given(loads=st.tuples(*[st.integers(-1000, 1000) for _ in range(4)]), seed=st.integers(0, 50))
def test_relief_only_stops_an_uncalibrated_hand(bench, loads, seed):
    b = bench(seed)
    b.run(0.3)
    before = np.array(b.device.state()["angles"])
    for motor, load in enumerate(loads):
        b.device.set_load(motor, load)
    b.run(1.0)
    moved = np.array(b.device.state()["angles"]) - before
    np.testing.assert_allclose(moved, 0, atol=0.02)


def test_a_hot_finger_is_not_closed_further(bench):
    b = bench().calibrated()
    b.command(1.0, 1.0, 1.0, 0)
    b.run(1.0)
    b.device.set_servo(0, temperature=75)
    b.run(0.1)
    for goal in np.arange(0.9, 2.0, 0.01):
        b.command(goal, goal, goal, 0)
        b.run(0.025)
        b.command(goal - 0.3, goal, goal, 0)
        b.command(goal, goal, goal, 0)
    np.testing.assert_allclose(angles(b)[:3], (0.6, 1.99, 1.99), atol=0.05)
    assert b.said("f1 has 75 degrees")
    assert status(b.driver, "", b.now)[:2] == ("warning", "Motor f1 is hot.")


def test_set_speed_is_three_packets_in_time_and_targets_wait(bench):
    b = bench().calibrated()
    before = len(b.sent)
    begin = b.now
    b.take(b.driver.set_speed((1, 2, 3, 3.5), b.now))
    b.command(1, 1, 1, 0)
    b.command(2, 2, 2, 0)
    assert b.driver.state(b.now) is HandStatus.CHANGING_SPEED
    times = []
    while b.driver.state(b.now) is HandStatus.CHANGING_SPEED:
        count = len(b.sent)
        b.run(0.025)
        times += [b.now - begin] * (len(b.sent) - count)
    sent = b.sent[before:]
    assert sent[:3] == [encode_mode(VELOCITY), bytes.fromhex("02 0076 04ed 0164 05b7"), encode_mode(POSITION)]
    assert sent[3:] == [last_target(b)] and len(sent) == 4
    assert b.device.state()["speed_settings"] == [118, 1261, 356, 1463]
    b.run(3.0)
    np.testing.assert_allclose(angles(b)[:3], 2, atol=0.01)


def test_a_hand_that_was_moved_without_torque_stays_where_it_is(bench):
    b = bench().calibrated()
    b.command(2, 2, 2, 0)
    b.run(0.1)
    b.take(b.driver.disable_torque())
    b.run(0.5)
    before = angles(b)
    assert before.max() < 1.0
    b.take(b.driver.set_speed((3, 3, 3, 2), b.now))
    b.run(2.0)
    np.testing.assert_allclose(angles(b), before, atol=0.01)


def test_without_torque_commands_are_refused_until_the_speed_is_set(bench):
    b = bench().calibrated()
    b.take(b.driver.disable_torque())
    assert b.sent[-1] == encode_mode(IDLE)
    before = len(b.sent)
    assert "Torque is off" in b.command(1, 1, 1, 0).refusal
    assert "Torque is off" in b.take(b.driver.calibrate_fingers(b.now)).refusal
    assert "Torque is off" in b.take(b.driver.command_raw((14000,) * 4, b.now)).refusal
    b.run(1.0)
    assert len(b.sent) == before and b.driver.state(b.now) is HandStatus.TORQUE_OFF
    b.take(b.driver.set_speed((3, 3, 3, 2), b.now))
    b.run(0.3)
    assert not b.command(1, 1, 1, 0).refusal


def test_torque_off_ends_a_calibration_and_a_change_of_speed(bench):
    b = bench()
    b.run(0.3)
    b.take(b.driver.calibrate_fingers(b.now))
    b.run(0.1)
    b.take(b.driver.disable_torque())
    b.run(1.0)
    assert b.sent[-1] == encode_mode(IDLE)
    assert "Torque was switched off" in b.driver.calibration_outcome
    b.take(b.driver.set_speed((1, 1, 1, 1), b.now))
    b.take(b.driver.disable_torque())
    b.run(1.0)
    assert b.sent[-1] == encode_mode(IDLE)


def test_position_mode_is_sent_again_after_a_pause(bench):
    b = bench().calibrated()
    b.command(1, 1, 1, 0)
    b.run(1.0)
    b.device.set_silent(True)
    b.run(2.0)
    assert b.driver.state(b.now) is HandStatus.SILENT
    assert sum("silent" in note.text for note in b.notes) == 1
    assert "silent" in b.command(2, 2, 2, 0).refusal
    assert status(b.driver, "", b.now)[0] == "error"
    before = len(b.sent)
    b.device.set_silent(False)
    b.run(1.0)
    assert b.sent[before:] == [encode_mode(POSITION)]
    np.testing.assert_allclose(angles(b)[:3], 1, atol=0.01)


def test_a_hand_that_was_switched_off_does_not_move_by_itself_and_asks_for_calibration(bench):
    b = bench(3).calibrated()
    b.command(3.0, 3.0, 3.0, 0)
    b.run(2.0)
    before = b.device.state()["angles"]
    b.device.power_cycle()
    b.run(2.0)
    assert b.said("switched off and on")
    assert b.device.state()["torque"] == [True] * 4
    assert b.device.state()["speed_settings"] == [356, 1380, 356, 1275]
    np.testing.assert_allclose(b.device.state()["angles"], before, atol=0.01)


def test_a_servo_that_counts_from_another_turn_is_held(bench):
    b = bench().calibrated()
    b.command(2, 2, 2, 0)
    b.run(2.0)
    before = np.array(b.device.state()["angles"])
    b.device.jump(0, 1)
    b.run(1.0)
    np.testing.assert_allclose(b.device.state()["angles"], before, atol=0.2)
    assert b.said("jumped by a turn")
    assert "calibrate the fingers" in b.command(2, 2, 2, 0).refusal


def test_a_servo_that_answers_again_gets_its_speed_and_stays(bench):
    b = bench().calibrated()
    b.command(2, 2, 2, 0)
    b.run(1.5)
    b.device.unplug_servo(1, True)
    b.run(0.5)
    b.device.servos[1].power_up()
    b.device.unplug_servo(1, False)
    before = b.device.state()["angles"]
    b.run(1.0)
    assert b.said("All servos answer again")
    assert b.device.state()["speed_settings"] == [356, 1380, 356, 1275]
    assert b.device.state()["torque"] == [True] * 4
    np.testing.assert_allclose(b.device.state()["angles"], before, atol=0.01)


def test_zero_pose_takes_the_pose_and_lets_the_tendons_out(bench):
    b = bench().calibrated()
    b.command(0.5, 0.5, 0.5, 0.5)
    b.run(1.0)
    before = np.array(b.device.state()["angles"])
    b.take(b.driver.zero_pose(b.now))
    b.run(1.0)
    moved = np.array(b.device.state()["angles"]) - before
    np.testing.assert_allclose(moved, [-0.216, -0.216, -0.216, 0], atol=0.01)
    np.testing.assert_allclose(angles(b), 0, atol=0.01)
    assert b.zeros is not None


def test_zero_pose_of_a_loaded_hand_is_not_relieved_by_the_old_zeros(bench):
    b = bench()
    b.device.set_load(0, 700)
    b.run(0.3)
    b.take(b.driver.zero_pose(b.now))
    b.run(1.0)
    assert b.device.state()["angles"][0] > -0.5


def test_torque_stays_off_while_a_servo_is_missing(bench):
    b = bench().calibrated()
    b.take(b.driver.disable_torque())
    b.device.unplug_servo(1, True)
    b.run(0.1)
    assert "f2 (0) cannot be right" in b.take(b.driver.set_speed((3, 3, 3, 2), b.now)).refusal
    assert b.device.state()["torque"] == [False] * 4
    b.device.unplug_servo(1, False)
    b.run(0.1)
    assert not b.take(b.driver.set_speed((3, 3, 3, 2), b.now)).refusal


def test_status_names_the_servo_that_reports_an_error(bench):
    b = bench().calibrated()
    assert status(b.driver, "", b.now)[:2] == ("ok", "The hand is ready.")
    b.device.set_servo(2, error=0x24)
    b.run(0.05)
    assert status(b.driver, "", b.now)[:2] == ("error", "Servo f3 reports overheating, overload.")


actions = st.lists(
    st.sampled_from(
        ["command", "raw", "speed", "off", "fingers", "tactile", "zero", "silent", "loud", "cycle", "jump", "unplug",
         "plug", "load", "free", "stick", "run"]
    ),
    max_size=25,
)  # fmt: skip


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=actions, seed=st.integers(0, 100))
def test_any_sequence_of_events_leaves_a_driver_that_works(bench, plan, seed):
    b = bench(seed)
    do = {
        "command": lambda: b.command(2, 2, 2, 1),
        "raw": lambda: b.take(b.driver.command_raw(b.device.state()["positions"], b.now)),
        "speed": lambda: b.take(b.driver.set_speed((3, 3, 3, 2), b.now)),
        "off": lambda: b.take(b.driver.disable_torque()),
        "fingers": lambda: b.take(b.driver.calibrate_fingers(b.now)),
        "tactile": lambda: b.take(b.driver.calibrate_tactile(b.now)),
        "zero": lambda: b.take(b.driver.zero_pose(b.now)),
        "silent": lambda: b.device.set_silent(True),
        "loud": lambda: b.device.set_silent(False),
        "cycle": b.device.power_cycle,
        "jump": lambda: b.device.silent or not b.device.servos[seed % 4].present or b.device.jump(seed % 4, 1),
        "unplug": lambda: b.device.unplug_servo(seed % 4, True),
        "plug": lambda: b.device.unplug_servo(seed % 4, False),
        "load": lambda: b.device.set_load(seed % 4, 700),
        "free": lambda: b.device.set_load(seed % 4, None),
        "stick": lambda: b.device.stick_encoder(seed % 3, True),
        "run": lambda: b.run(0.7),
    }
    for action in plan:
        do[action]()
        b.run(0.15)
        status(b.driver, "", b.now)
        low = -1.5 - 0.22 * plan.count("zero")
        assert all(low < angle < 4.2 for angle in b.device.state()["angles"]), action
    b.device.set_silent(False)
    b.device.unplug_servo(seed % 4, False)
    b.device.set_load(seed % 4, None)
    b.device.stick_encoder(seed % 3, False)
    b.run(12.0)
    b.take(b.driver.set_speed((3, 3, 3, 2), b.now))
    b.run(0.5)
    assert b.driver.state(b.now) is HandStatus.READY


def test_what_is_out_of_range_or_not_for_every_motor_is_refused_and_nothing_is_sent(bench):
    """At a speed of 0 the fingers would stop for ever; at a threshold of 0 the noise of a taxel would be a touch."""
    b = bench().calibrated()
    b.take(b.driver.calibrate_tactile(b.now))
    b.run(0.5)
    before = list(b.sent)
    wrong = (math.nan, math.inf, -math.inf, 1e30, 3.51, 0, -1)
    speeds = [[value if i == motor else 1.0 for i in range(4)] for value in wrong for motor in range(4)]
    for speed in (*speeds, [], [1.0] * 3):
        assert "refused" in b.take(b.driver.set_speed(speed, b.now)).refusal, speed
    counts = [[[20] * 9, [20] * 9, [20] * 8 + [count]] for count in (0, -1, 65536)]
    for count in (*counts, [[20] * 9] * 2, [[], [], []], []):
        assert "refused" in b.take(b.driver.set_thresholds(count)).refusal, count
    assert b.take(b.driver.command((1, 1, 1), b.now)).refusal
    for raw in ((14000,) * 3, (70000,) * 4):
        assert b.take(b.driver.command_raw(raw, b.now)).refusal
    b.run(0.5)
    assert b.sent == before and b.driver.state(b.now) is HandStatus.READY
    assert not np.any(b.reading.contact)


def test_a_calibration_of_stuck_encoders_fails_and_drops_the_waiting_command(bench):
    """Reported in https://github.com/RightHandRobotics/reflex-ros-pkg/issues/42: an encoder that sticks while fingers
    are calibrated. Tried: stuck encoders.
    """
    b = bench()
    b.run(0.3)
    before = b.device.state()["angles"]
    b.device.stick_encoder(1, True)
    b.take(b.driver.calibrate_fingers(b.now))
    b.run(0.1)
    b.command(2, 2, 2, 0)
    b.run(10.0)
    assert b.driver.calibration_outcome.startswith("failed: Finger f2")
    assert b.zeros is None
    np.testing.assert_allclose(b.device.state()["angles"], before, atol=0.01)
    b.device.stick_encoder(1, False)
    b.calibrated()
    b.run(1.0)
    np.testing.assert_allclose(angles(b), 0, atol=0.01)


@pytest.mark.parametrize(("load", "end"), [(600, 0.0), (-600, TRAVEL[0])])
def test_a_finger_loosened_to_its_end_can_be_used_again(bench, load, end):
    b = bench().calibrated()
    b.command(1, 1, 1, 0)
    b.device.set_load(0, load)
    b.run(6.0)
    b.device.set_load(0, None)
    b.run(1.0)
    assert angles(b)[0] == pytest.approx(end, abs=0.01)
    b.command(end, 1, 1, 0)
    b.command(1, 1, 1, 0)
    b.run(2.0)
    assert angles(b)[0] == pytest.approx(1, abs=0.01)


def test_idle_is_sent_again_after_a_pause_without_torque(bench):
    b = bench().calibrated()
    b.take(b.driver.disable_torque())
    b.device.set_silent(True)
    b.run(1.0)
    b.device.set_silent(False)
    b.run(0.5)
    assert b.sent[-2:] == [encode_mode(IDLE)] * 2
