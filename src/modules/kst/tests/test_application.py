"""The client and the words of the robot application, by a scripted server in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from common import clock
from kst import (
    ApplicationSettings,
    Feedback,
    KstClient,
    KstError,
    KstMode,
    MotionInterrupted,
    MotionRefused,
    MotionStopped,
    NotLeapRig,
    RobotState,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WordRefused,
    WrongMode,
)

GOAL = np.full(7, 0.1)
TOOL = {"tool_mass": 1.12, "tool_centre": (-0.022, 0.0, 0.0727)}


def test_it_greets_sets_the_watchdog_and_joins_a_second_time(greet, application):
    client = greet(brake_after=0.3, end_after=5.0)
    assert application.lines[:3] == ["lrHello_1_", "lrWatchdog_0.3_5.0_", "TFtrans_0.0_0.0_0.0_0.0_0.0_0.0_"]
    assert application.channel == ["lrChannel_123456_"]
    assert client.server == "LeapRigServer 1" and client.abilities >= {"stop", "tool", "state"}


def test_without_settings_no_word_of_it_is_said(connect, server):
    client = connect()
    assert server.words() == ["TFtrans"] and client.server == "toolbox" and not client.abilities
    client.beat()
    for call in (client.stop_motion, client.pause_motion, client.resume_motion, client.state):
        with pytest.raises(WrongMode, match="toolbox's server cannot"):
            call()
    assert server.words() == ["TFtrans"]


def test_the_toolbox_is_told_from_it(server, connect):
    with pytest.raises(
        NotLeapRig, match="speaks the toolbox's words only; start LeapRigServer on the smartPad, or set"
    ):
        KstClient.connect("127.0.0.1", server.port, application=ApplicationSettings())
    assert server.has_ended() and server.words()[-1] == "end"


@pytest.mark.parametrize("answer", ["ok_lrHello_leapRig_2_123456_stop_", "ok_lrHello_leapRig_1_x_", "ok_lrHello_"])
def test_another_version_is_refused(greet, application, answer):
    application.answers["lrHello"] = f"{answer}\n".encode()
    with pytest.raises(NotLeapRig, match="knows version 1"):
        greet()


def test_who_holds_the_arm_is_said(greet, application):
    application.answers["lrHello"] = b"busy_172.31.1.20:40112_\n"
    with pytest.raises(ServerBusy, match=r"is held by 172.31.1.20:40112; end that client"):
        greet()


@pytest.mark.parametrize("times", [(0.04, 10.0), (2.1, 10.0), (0.2, 0.2), (0.2, 61.0), (np.nan, 10.0), (0.2, np.nan)])
def test_times_out_of_range_are_refused(times):
    with pytest.raises(ValueError, match="the watchdog's times"):
        ApplicationSettings(*times)


def test_the_tool_goes_with_its_mass_and_the_answer_is_checked(greet, application):
    greet(**TOOL)
    (line,) = (line for line in application.lines if line.startswith("lrTool"))
    assert line == "lrTool_1.12_-22.0_0.0_72.7_0.0_0.0_0.0_0.0_0.0_0.0_"
    assert "TFtrans" not in application.words()


@pytest.mark.parametrize(
    "answer", ["ok_lrTool_1.0_-22.0_0.0_72.7_", "ok_lrTool_1.12_22.0_0.0_72.7_", "ok_lrTool_", "no_lrTool_too heavy_"]
)
def test_a_robot_that_reckons_with_another_tool_is_not_used(greet, application, answer):
    application.answers["lrTool"] = f"{answer}\n".encode()
    with pytest.raises(ToolNotAttached, match="reckons with|too heavy"):
        greet(**TOOL)


def test_a_load_counts_with_the_tool(greet, application):
    T_flange_tool = np.eye(4)
    T_flange_tool[2, 3] = 0.18
    client = greet(T_flange_tool, **TOOL)
    application.answers["lrLoad"] = b"ok_lrLoad_1.62_-15.21_0.0_105.817_\n"
    client.set_load(0.5)
    assert application.lines[-1] == "lrLoad_0.5_0.0_0.0_180.0_"
    application.answers["lrLoad"] = b"ok_lrLoad_1.12_-22.0_0.0_72.7_\n"
    with pytest.raises(WordRefused, match="reckons with"):
        client.set_load(0.5)


def moving(client):
    client.start_ptp_joints(GOAL, 0.5)
    assert not client.ptp_arrived()
    return client


def test_what_stopped_a_motion_is_said(greet, application):
    client = moving(greet())
    application.push(b"stopped_a safety stop, STOP1_\n")
    with pytest.raises(MotionStopped, match="was stopped by a safety stop, STOP1") as caught:
        client.ptp_arrived()
    assert caught.value.reason == "a safety stop, STOP1" and client.mode is KstMode.IDLE


def test_a_contact_is_an_interruption(greet, application):
    client = moving(greet())
    application.push(b"stopped_contact, joint 3_\n")
    with pytest.raises(MotionInterrupted) as caught:
        client.ptp_arrived()
    np.testing.assert_allclose(caught.value.torques, np.arange(1, 8) / 10.0)


def test_a_stop_goes_by_the_second_connection_and_by_another_if_that_is_lost(greet, application):
    client = moving(greet())
    client.stop_motion()
    clock.sleep(0.01)
    assert application.channel == ["lrChannel_123456_", "lrStop_"] and "lrStop" not in application.words()
    application.lose_channel()
    assert client.events() == client.events() == []  # the second look finds its end
    client.stop_motion()
    assert application.channel[2:] == ["lrStop_"]


def test_a_stop_that_cannot_be_sent_raises(greet, application):
    client = moving(greet())
    application.lose_channel()
    application._listener.really_close()
    assert client.events() == []
    with pytest.raises(KstError):
        client.stop_motion()


def test_pause_and_resume(greet, application):
    client = moving(greet())
    client.pause_motion()
    with pytest.raises(WordRefused, match="refused `lrResume`: the mode is IDLE"):
        client.resume_motion()
    assert not client.ptp_arrived()
    application.push(b"done\n")
    assert client.ptp_arrived()


def longest_silence(application, lines):
    return max(b - a for a, b in zip(lines, lines[1:]))


def watched(wires):
    times = []
    wires.connections[0].up.sent = lambda data, now: times.append(now)
    return times


def test_while_it_waits_for_a_motion_the_watchdog_hears_it(greet, application, wires):
    client, times = greet(), watched(wires)
    clock.Thread(target=lambda: (clock.sleep(2.0), application.push(b"done\n")), daemon=True).start()
    client.ptp_joints(GOAL, 0.5, 10.0)
    assert longest_silence(application, times) < 0.15


def test_while_servo_mode_starts_the_watchdog_hears_it(greet, application, wires):
    client, times = greet(), watched(wires)
    client.start_joint_servo()
    client.servo(GOAL)
    assert longest_silence(application, times) < 0.1


def test_a_goal_brings_the_whole_state(greet, application):
    client = greet()
    client.start_joint_servo()
    state = client.servo(GOAL, Feedback.STATE)
    assert application.lines[-1] == "jpState_" + "0.1_" * 7
    assert isinstance(state, RobotState)
    for value, expected, size in zip(state[1:6], (0.5, 1.5, 2.5, 3.5, 4.5), (7, 7, 7, 3, 3)):
        np.testing.assert_array_equal(value, np.full(size, expected))
    assert (state.mode, *state[6:]) == ("SERVO", 0.002, "T1", "HAND", "NOSTOP")
    client.stream(GOAL, Feedback.STATE)
    (answer,) = client.answers(0.1)
    assert answer[0] is Feedback.STATE and answer[1].safety_stop == "NOSTOP"


@pytest.mark.parametrize("mode", ["HELD", "IDLE"])
def test_a_robot_that_left_the_stream_says_so_with_its_reason(greet, application, mode):
    client = greet()
    client.start_joint_servo()
    application.be(mode)
    application.tell("servo mode begins")
    application.tell("the arm brakes and holds: the client was silent")
    with pytest.raises(MotionStopped, match="the arm brakes and holds: the client was silent"):
        client.servo(GOAL, Feedback.STATE)
    client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    assert client.state().mode == mode


def test_a_goal_that_is_refused_as_the_arm_is_held(greet, application):
    client = greet()
    client.start_joint_servo()
    application.answers["jpState"] = b"no_jpState_held: paused_\n"
    client.stream(GOAL, Feedback.STATE)
    ((_, error),) = client.answers(0.1)
    assert isinstance(error, MotionStopped)


@pytest.mark.parametrize("line", ["state_SERVO_0.1_T1_HAND_NOSTOP_", "state_", "0.5_0.5_0.5_"])
def test_a_torn_state_is_left_out(greet, application, line):
    client = greet()
    client.start_joint_servo()
    application.answers["jpState"] = f"{line}\n".encode()
    with pytest.raises(KstError):
        client.servo(GOAL, Feedback.STATE)


def test_a_state_that_is_no_number_is_left_out(greet, application):
    client = greet()
    client.start_joint_servo()
    application.answers["jpState"] = application.answers["jpState"].replace(b"0.5", b"NaN", 1)
    with pytest.raises(UnexpectedReply, match="not all numbers"):
        client.servo(GOAL, Feedback.STATE)


def test_a_refused_motion_keeps_the_tool(greet, application):
    client = greet(**TOOL)
    client.start_ptp_joints(GOAL, 0.5)
    application.push(b"nak\n")
    with pytest.raises(MotionRefused):
        client.ptp_arrived()
    assert application.words().count("lrTool") == 1


def test_a_servo_mode_that_a_stop_forestalled(greet, application):
    client = greet()
    application.answers["startDirectServoJoints"] = b"stopped_the client_\n"
    with pytest.raises(MotionStopped, match="stopped by the client"):
        client.start_joint_servo()
    assert client.mode is KstMode.IDLE
