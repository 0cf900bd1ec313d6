"""Answers that are wiped, late, foreign or doubled: a result is the answer to its own question, or there is none."""

import numpy as np
import pytest

from common import clock
from kst.client import KstMode
from kst.codec import Feedback
from kst.errors import ConnectionLost, ReplyTimeout, UnexpectedReply
from kst.session import KstTiming
from simulated.wires import DELAY_S

HOME = np.array([-0.7854, 0.5236, 0.0, -1.39626, 0.0, 1.22173, 0.0])
AWAY = HOME + 0.1
TORQUES = np.arange(1, 8) / 10
WAITS = KstTiming()


def joints(first):
    return b"%f_0.0_0.0_0.0_0.0_0.0_0.0_\n" % first


@pytest.mark.parametrize("wiped", ["TFtrans", "jRelVel", "doPTPinJS", "startDirectServoJoints", "Torques_ext_J"])
def test_a_wiped_command_is_sent_again(server, connect, wiped):
    server.once(wiped, b"")
    client = connect()
    server.once("doPTPinJS", b"done\ndone\n")
    client.ptp_joints(AWAY, 0.25, timeout=10.0)
    np.testing.assert_allclose(client.external_torques(), TORQUES)
    client.start_joint_servo()
    client.servo(HOME)
    client.stop_joint_servo()
    assert server.words().count(wiped) == 2
    assert (client.counts.missed, client.counts.resent, client.counts.stray) == (1, 1, 0)


def test_it_looks_at_the_joints_before_it_sends_again(server, connect):
    client = connect()
    server.once("doPTPinJS", b"")
    client.start_ptp_joints(AWAY, 0.25)
    assert server.words()[3:] == ["doPTPinJS", *["getJointsPositions"] * 4, "doPTPinJS"]


def test_nothing_is_sent_again_while_the_arm_moves(server, connect):
    client = connect()
    server.once("doPTPinJS", b"")
    server.once("getJointsPositions", *(joints(0.01 * i) for i in range(3)))
    client.start_ptp_joints(AWAY, 0.25)
    assert server.words().count("doPTPinJS") == 1
    assert client.mode is KstMode.PTP
    assert not client.ptp_arrived()


def test_nothing_is_sent_again_to_an_arm_that_is_at_the_goal_already(server, connect, takes):
    client = connect()
    server.once("doPTPinJS", b"")
    client.start_ptp_joints(HOME, 0.25)
    assert server.words().count("doPTPinJS") == 1
    assert not client.ptp_arrived(), "the words of the motion may still come"
    with takes(WAITS.reply):
        while not client.ptp_arrived():
            clock.sleep(0.001)
    server.push(b"done\ndone\n")
    np.testing.assert_array_equal(client.joints(), HOME)
    client.start_ptp_joints(AWAY, 0.25)
    assert not client.ptp_arrived()


@pytest.mark.parametrize("word", ["jRelVel", "doPTPinJS", "startDirectServoJoints", "Torques_ext_J"])
def test_a_dead_main_thread_is_distinguished_from_a_dead_link(server, connect, word):
    client = connect()
    server.answers[word] = b""
    with pytest.raises(ReplyTimeout) as caught:
        client.start_ptp_joints(AWAY, 0.25)
        server.push(b"done\n")
        assert client.ptp_arrived()
        client.external_torques()
        client.start_joint_servo()
    assert caught.value.command == word and "restart MatlabToolboxServer there" in str(caught.value)
    assert client.mode is KstMode.IDLE
    assert server.words().count(word) == WAITS.tries
    np.testing.assert_array_equal(client.joints(), HOME)


def test_a_late_acknowledgement_does_not_count_for_the_next_goal(server, connect):
    client = connect()
    client.start_joint_servo()
    server.once("jp", b"")
    with pytest.raises(ReplyTimeout):
        client.servo(HOME)
    server.once("getJointsPositions", b"done\n" + server.answers["getJointsPositions"])
    server.once("jp", b"")
    with pytest.raises(ReplyTimeout):
        client.servo(HOME)


def test_a_probe_whose_answer_is_missing_is_searched_for_like_any_other_answer(server, connect, takes):
    client = connect()
    client.start_joint_servo()
    server.once("jp", b"")
    with pytest.raises(ReplyTimeout):
        client.servo(HOME)
    server.once("getJointsPositions", b"", joints(1.0))
    server.once("getPin3", joints(0.5) + b"1\n\n")
    with takes(WAITS.probe + WAITS.quiet):
        while client.silence(0.02):
            pass
    np.testing.assert_array_equal(client.joints(), HOME)
    assert "getPin3" in server.words()


def test_a_flood_of_lines_does_not_hold_a_call_for_ever(server, connect):
    client = connect()
    server.once("getJointsPositions", b"")
    with pytest.raises(ReplyTimeout):
        client.joints()
    server.answers["getPin3"] = b"0.5_0.5_0.5_\n" * 1000 + b"1\n\n"
    with pytest.raises(ConnectionLost):
        client.joints()


@pytest.mark.parametrize("garbage", [b"\xff\x00\x12\n", b"hello\n", b"9" * 5000 + b"\n", b"1.0_2.0_\n"])
def test_garbage_before_an_answer_is_dropped_and_counted(server, connect, garbage):
    client = connect()
    server.once("getJointsPositions", garbage + server.answers["getJointsPositions"])
    np.testing.assert_array_equal(client.joints(), HOME)
    assert client.counts.foreign == 1


def test_an_answer_of_the_wrong_kind_leaves_the_next_one_right(server, connect):
    client = connect()
    server.once("getJointsPositions", b"done\n")
    server.once("getPin3", joints(1.0) + b"1\n\n")
    with pytest.raises(UnexpectedReply) as caught:
        client.joints()
    assert (caught.value.command, caught.value.reply) == ("getJointsPositions", "done")
    for _ in range(3):
        np.testing.assert_array_equal(client.joints(), HOME)
    assert "getPin3" in server.words()


def test_the_pose_of_an_old_server_is_its_force(server, connect):
    client = connect()
    client.start_joint_servo()
    server.answers["jpEEfP"] = b"0.0_0.0_0.0_\n"
    with pytest.raises(UnexpectedReply):
        client.servo(HOME, Feedback.POSE)


def test_a_pause_follows_every_answer_of_the_main_thread(connect):
    client = connect()
    client.external_torques()
    pause = WAITS.main_pause
    for ask, seconds in ((client.external_torques, pause), (client.joints, pause), (client.joints, 0.0)):
        begun = clock.monotonic()
        ask()
        assert clock.monotonic() - begun == pytest.approx(seconds + 2.0 * DELAY_S)


def test_the_waits_which_all_tests_use_are_as_shipped():
    settle = {"connect_settle": 1.0, "tool_settle": 0.4, "main_pause": 0.005, "servo_start": 0.3, "servo_stop": 0.1}
    answers = {"reply": 1.0, "servo_reply": 0.16, "servo_window": 0.1, "quiet": 0.1, "probe": 1.0, "silence": 10.0}
    assert KstTiming() == KstTiming(**settle, **answers, rest=0.5, farewell=0.2, tries=3)


def test_an_unasked_line_is_not_the_answer_to_the_next_question(server, connect):
    client = connect()
    server.push(joints(1.0))
    np.testing.assert_array_equal(client.joints(), HOME)
    assert client.counts.stray == 1
