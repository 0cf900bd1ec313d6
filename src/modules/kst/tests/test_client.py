"""What the client says, refuses and reports, against a scripted server."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from common.poses import translation
from kst.client import KstClient, KstMode
from kst.codec import Feedback
from kst.errors import (
    BadJoints,
    BadVelocity,
    ConnectionLost,
    MotionRefused,
    NoServer,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WrongMode,
)
from kst.session import KstTiming

pytestmark = pytest.mark.clock

HOME = np.array([-0.7854, 0.5236, 0.0, -1.39626, 0.0, 1.22173, 0.0])
GOAL = "jp_-0.7854_0.5236_0.0_-1.39626_0.0_1.22173_0.0_"
BRIEF = KstTiming(connect_settle=0.0, tool_settle=0.0, reply=0.4, quiet=0.02, tries=2)

SERVO_CALLS = {
    Feedback.DONE: ("jp", b"done\n", None),
    Feedback.JOINTS: ("jpJP", b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n", np.arange(1, 8) / 10),
    Feedback.EXTERNAL_TORQUES: ("jpExT", b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n", np.arange(1, 8) / 10),
    Feedback.MEASURED_TORQUES: ("jpMT", b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n", np.arange(1, 8) / 10),
    Feedback.POSE: ("jpEEfP", b"100.0_-200.0_300.0_0.0_0.0_0.0_\n", translation(0.1, -0.2, 0.3)),
    Feedback.FORCE: ("jpEEfFrelEEF", b"1.0_2.0_-3.0E-4_\n", [1.0, 2.0, -3e-4]),
}
MAIN_GETTERS = {
    KstClient.external_torques: ("Torques_ext_J", b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n", np.arange(1, 8) / 10),
    KstClient.measured_torques: ("Torques_m_J", b"0.1_0.2_0.3_0.4_0.5_0.6_0.7_\n", np.arange(1, 8) / 10),
    KstClient.pose: ("Eef_pos", b"100.0_-200.0_300.0_0.0_0.0_0.0_\n", translation(0.1, -0.2, 0.3)),
    KstClient.force: ("Eef_force", b"1.0_2.0_-3.0E-4_\n", [1.0, 2.0, -3e-4]),
    KstClient.moment: ("Eef_moment", b"1.0_2.0_-3.0E-4_\n", [1.0, 2.0, -3e-4]),
}


def test_connecting_attaches_the_tool_and_closing_says_end(server):
    tool = translation(0.0, 0.0, 0.106)
    with KstClient.connect("127.0.0.1", server.port, tool, timing=KstTiming(connect_settle=0.0)) as client:
        assert client.mode is KstMode.IDLE
        assert client.round_trip > 0.0
    assert server.wait_for_end()
    assert server.words() == ["TFtrans", "end"]
    assert [float(f) for f in server.lines[0].split("_")[1:-1]] == [0.0, 0.0, 106.0, 0.0, 0.0, 0.0]


def test_nobody_listens(free_port):
    port = free_port()
    with pytest.raises(NoServer) as caught:
        KstClient.connect("127.0.0.1", port)
    assert caught.value.address == f"127.0.0.1:{port}"


@pytest.mark.parametrize("reset", [False, True])
def test_the_server_ends_at_once(server, reset):
    server.answers.clear()
    ender = threading.Timer(0.1, server.end, [reset])
    ender.start()
    with pytest.raises(NoServer):
        KstClient.connect("127.0.0.1", server.port, timing=KstTiming(connect_settle=0.0, reply=5.0))
    ender.join()


def test_an_open_port_that_stays_silent(server):
    server.answers.clear()
    with pytest.raises(ServerBusy):
        KstClient.connect("127.0.0.1", server.port, timing=BRIEF, timeout=0.3)
    assert server.wait_for_end()


@pytest.mark.parametrize("answer", [b"", b"nak\n"])
def test_a_server_that_does_not_attach_the_tool(server, answer):
    server.answers["TFtrans"] = answer
    with pytest.raises(ToolNotAttached):
        KstClient.connect("127.0.0.1", server.port, timing=BRIEF)
    assert server.wait_for_end()
    assert server.lines[-1] == "end"


def test_something_else_listens_there(server):
    server.answers["TFtrans"] = b"HTTP/1.1 400 Bad Request\r\nServer: x\r\n\r\n" * 50
    with pytest.raises(UnexpectedReply) as caught:
        KstClient.connect("127.0.0.1", server.port, timing=replace(BRIEF, reply=20.0))
    assert caught.value.command == "TFtrans"


def test_a_bad_tool_opens_no_connection(server):
    with pytest.raises(ValueError):
        KstClient.connect("127.0.0.1", server.port, translation(0.0, 0.0, 106.0))
    assert server.connection is None


@pytest.mark.parametrize("getter", MAIN_GETTERS)
def test_getters_when_idle(server, connect, getter):
    word, answer, expected = MAIN_GETTERS[getter]
    server.answers[word] = answer
    np.testing.assert_allclose(getter(connect()), expected, rtol=1e-15)
    assert server.words()[1:] == [word]


def test_joints_lights_and_pins(server, connect):
    server.answers.update(blueOn=b"done\n", blueOff=b"done\n", pin11on=b"done\n", pin2off=b"done\n", getPin10=b"0\n\n")
    client = connect()
    np.testing.assert_array_equal(client.joints(), HOME)
    client.set_blue(True)
    client.set_blue(False)
    client.set_pin(11, True)
    client.set_pin(2, False)
    assert client.pin(3) is True
    assert client.pin(10) is False
    np.testing.assert_array_equal(client.joints(), HOME)
    assert server.lines[2:-1] == ["blueOn", "blueOff", "pin11on", "pin2off", "getPin3", "getPin10"]
    with pytest.raises(ValueError):
        client.set_pin(3, True)
    assert client.counts.stray == client.counts.foreign == client.counts.missed == 0


def test_numbers_the_controller_does_not_know_are_not_passed_on(server, connect):
    server.answers["getJointsPositions"] = b"0.0_NaN_0.0_0.0_0.0_0.0_0.0_\n"
    client = connect()
    with pytest.raises(UnexpectedReply) as caught:
        client.joints()
    assert caught.value.reply.startswith("0.0_NaN")


def test_a_ptp_motion_and_its_two_answers(server, connect, wait_until):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    assert client.mode is KstMode.PTP
    assert not client.ptp_arrived()
    assert server.lines[1:] == ["jRelVel_0.25_", GOAL, "doPTPinJS"]
    server.push(b"done\n")
    assert wait_until(client.ptp_arrived, 10.0, "the arrival")
    assert client.mode is KstMode.IDLE
    with pytest.raises(WrongMode):
        client.ptp_arrived()


@pytest.mark.parametrize("mixed", [b"done\n%s", b"%sdone\n"])
def test_the_final_word_may_come_between_or_after_numbers(server, connect, wait_until, mixed):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    np.testing.assert_array_equal(client.joints(), HOME)
    assert not client.ptp_arrived()
    server.once("getJointsPositions", mixed % server.answers["getJointsPositions"])
    np.testing.assert_array_equal(client.joints(), HOME)
    assert client.mode is KstMode.PTP
    assert wait_until(client.ptp_arrived, 10.0, "the arrival")
    np.testing.assert_array_equal(client.joints(), HOME)
    assert client.counts.stray == 0


def test_lights_during_a_motion_do_not_end_it(server, connect, wait_until):
    server.answers["blueOn"] = b"done\n"
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    client.set_blue(True)
    assert not client.ptp_arrived()
    server.once("blueOn", b"done\ndone\n")
    client.set_blue(True)
    assert wait_until(client.ptp_arrived, 10.0, "the arrival")


def test_a_blocking_motion(server, connect):
    server.answers["doPTPinJS"] = b"done\ndone\n"
    client = connect()
    client.ptp_joints(HOME, 0.25, timeout=10.0)
    assert client.mode is KstMode.IDLE


def test_a_motion_that_does_not_end_in_time_names_the_joint_that_is_farthest(server, connect, wait_until):
    client = connect()
    with pytest.raises(ReplyTimeout, match=r"joint 4 .* 5\.73 deg"):
        client.ptp_joints(HOME + 0.1 * np.eye(7)[3], 0.25, timeout=0.1)
    assert client.mode is KstMode.PTP
    server.push(b"done\n")
    assert wait_until(client.ptp_arrived, 10.0, "the late arrival")


@pytest.mark.parametrize("answer", [b"nak\n", b"done\nnak\n"])
def test_a_refused_motion_gets_its_tool_back(server, connect, answer):
    server.once("doPTPinJS", answer)
    client = connect()
    with pytest.raises(MotionRefused):
        client.ptp_joints(HOME, 0.25, timeout=10.0)
    assert client.mode is KstMode.IDLE
    assert server.words() == ["TFtrans", "jRelVel", "jp", "doPTPinJS", "TFtrans"]
    assert server.lines[0] == server.lines[-1]
    np.testing.assert_array_equal(client.joints(), HOME)


def test_a_refusal_that_comes_while_the_joints_are_read(server, connect):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    server.once("getJointsPositions", b"nak\n" + server.answers["getJointsPositions"])
    np.testing.assert_array_equal(client.joints(), HOME)
    with pytest.raises(MotionRefused):
        client.ptp_arrived()
    assert server.words()[-1] == "TFtrans"
    assert client.mode is KstMode.IDLE


def test_a_refusal_is_not_made_good_by_a_later_word(server, connect, wait_until):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    server.push(b"nak\ndone\n")
    with pytest.raises(MotionRefused):
        wait_until(client.ptp_arrived, 10.0, "the refusal")


def test_a_tool_that_cannot_be_attached_again(server, connect):
    client = connect(reply=0.4, tries=2, quiet=0.02)
    server.answers["TFtrans"] = b""
    server.once("doPTPinJS", b"done\nnak\n")
    with pytest.raises(ToolNotAttached):
        client.ptp_joints(HOME, 0.25, timeout=10.0)


def test_the_servo_starts_where_the_arm_stands(server, connect):
    client = connect()
    client.start_joint_servo()
    assert client.mode is KstMode.SERVO
    assert server.lines[1:] == ["getJointsPositions", GOAL, "startDirectServoJoints"]
    client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    assert server.lines[-1] == "stopDirectServoJoints"


@pytest.mark.parametrize("feedback", SERVO_CALLS)
def test_servo_goals(server, connect, feedback):
    word, answer, expected = SERVO_CALLS[feedback]
    client = connect()
    client.start_joint_servo()
    server.answers[word] = answer
    result = client.servo(HOME, feedback)
    assert server.lines[-1] == GOAL.replace("jp_", word + "_")
    if expected is None:
        assert result is None
    else:
        np.testing.assert_allclose(result, expected, rtol=1e-15)


def test_goals_without_answer(server, connect):
    client = connect()
    client.start_joint_servo()
    for _ in range(5):
        client.servo(HOME, Feedback.NOTHING)
    np.testing.assert_array_equal(client.joints(), HOME)
    assert server.words()[-6:] == ["jf"] * 5 + ["getJointsPositions"]


def test_goals_without_answer_notice_the_end_of_the_link(server, connect, wait_until):
    client = connect()
    client.start_joint_servo()
    server.end()

    def lost():
        try:
            client.servo(HOME, Feedback.NOTHING)
        except ConnectionLost:
            return True

    wait_until(lost, 10.0, "the loss to be noticed")


def test_the_stop_waits_until_the_arm_stands(server, connect):
    client = connect(rest=5.0)
    client.start_joint_servo()
    moving = [b"%f_0.0_0.0_0.0_0.0_0.0_0.0_\n" % (0.1 * i) for i in range(4)]
    server.once("getJointsPositions", *moving)
    client.stop_joint_servo()
    assert server.words()[-7:] == ["getJointsPositions"] * 6 + ["stopDirectServoJoints"]


def test_an_unasked_nak_in_the_servo_mode(server, connect):
    client = connect()
    client.start_joint_servo()
    server.once("jp", b"nak\ndone\n")
    with pytest.raises(MotionRefused):
        client.servo(HOME)
    assert client.mode is KstMode.IDLE
    assert server.words()[-2:] == ["stopDirectServoJoints", "TFtrans"]


def test_goals_without_answer_notice_an_unasked_nak(server, connect, wait_until):
    client = connect()
    client.start_joint_servo()
    server.push(b"nak\n")
    with pytest.raises(MotionRefused):
        wait_until(lambda: client.servo(HOME, Feedback.NOTHING), 10.0, "the refusal")
    assert client.mode is KstMode.IDLE


def test_an_unasked_nak_after_the_stop(server, connect):
    client = connect()
    client.start_joint_servo()
    server.once("stopDirectServoJoints", b"done\nnak\n")
    with pytest.raises(MotionRefused):
        client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    assert server.words()[-1] == "TFtrans"


def test_main_thread_getters_are_not_sent_when_nobody_would_answer(server, connect):
    client = connect()
    for mode, start in [
        (KstMode.SERVO, client.start_joint_servo),
        (KstMode.PTP, lambda: client.start_ptp_joints(HOME, 0.25)),
    ]:
        start()
        for getter in MAIN_GETTERS:
            with pytest.raises(WrongMode) as caught:
                getter(client)
            assert caught.value.mode is mode
        if mode is KstMode.SERVO:
            client.stop_joint_servo()
    assert not {word for word, *_ in MAIN_GETTERS.values()} & set(server.words())


def test_modes_that_exclude_each_other(server, connect):
    client = connect()
    for feedback in Feedback:
        with pytest.raises(WrongMode):
            client.servo(HOME, feedback)
    with pytest.raises(WrongMode):
        client.stop_joint_servo()
    assert server.words() == ["TFtrans"]
    client.start_joint_servo()
    for start in (lambda: client.start_ptp_joints(HOME, 0.5), client.start_joint_servo):
        with pytest.raises(WrongMode) as caught:
            start()
        assert caught.value.mode is KstMode.SERVO
    client.stop_joint_servo()
    client.start_ptp_joints(HOME, 0.25)
    for start in (lambda: client.start_ptp_joints(HOME, 0.5), client.start_joint_servo):
        with pytest.raises(WrongMode) as caught:
            start()
        assert caught.value.mode is KstMode.PTP


@pytest.mark.parametrize(
    "q", [[math.nan] * 7, [math.inf] + [0.0] * 6, [0.0] * 6, [0.0, 2.2, 0.0, 0.0, 0.0, 0.0, 0.0], [600.0] * 7, None]
)
def test_bad_joints_never_leave(server, connect, q):
    client = connect()
    with pytest.raises(BadJoints):
        client.start_ptp_joints(q, 0.25)
    client.start_joint_servo()
    before = len(server.lines)
    for feedback in Feedback:
        with pytest.raises(BadJoints):
            client.servo(q, feedback)
    client.joints()
    assert server.lines[before:] == ["getJointsPositions"]
    assert client.mode is KstMode.SERVO


@pytest.mark.parametrize("velocity", [0.0, 1.5, math.nan])
def test_bad_velocities_never_leave(server, connect, velocity):
    client = connect()
    with pytest.raises(BadVelocity):
        client.start_ptp_joints(HOME, velocity)
    assert server.words() == ["TFtrans"]


def test_the_servo_does_not_start_outside_the_limits(server, connect):
    server.answers["getJointsPositions"] = b"0.0_2.2_0.0_0.0_0.0_0.0_0.0_\n"
    client = connect()
    with pytest.raises(BadJoints) as caught:
        client.start_joint_servo()
    assert caught.value.joint == 2
    assert server.words() == ["TFtrans", "getJointsPositions"]
    assert client.mode is KstMode.IDLE


def test_closing_in_the_servo_mode_stops_it(server, connect):
    client = connect()
    client.start_joint_servo()
    client.close()
    assert server.wait_for_end()
    assert server.lines[-2:] == ["stopDirectServoJoints", "end"]
    assert client.mode is KstMode.IDLE
    client.close()
    with pytest.raises(ConnectionLost):
        client.joints()


def test_a_server_that_was_given_up_hears_the_farewell(server, connect):
    client = connect(silence=0.2)
    client.start_joint_servo()
    server.answers.clear()
    client._session.timing = replace(client._session.timing, reply=0.05, servo_reply=0.05)
    with pytest.raises(ReplyTimeout):
        client.servo(HOME)
    with pytest.raises(ConnectionLost):
        while client.silence(0.05):
            pass
    client.close()
    assert server.wait_for_end()
    assert server.lines[-2:] == ["stopDirectServoJoints", "end"]
    client.close()


@pytest.mark.parametrize("reset", [False, True])
def test_a_lost_link_stays_lost_and_closing_is_quiet(server, connect, reset):
    client = connect()
    server.end(reset)
    assert server.wait_for_end()
    for _ in range(3):
        with pytest.raises(ConnectionLost):
            client.joints()
    client.close()


def test_abort_from_another_thread_says_nothing_and_wakes_the_caller(server, connect):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    before = len(server.lines)
    threading.Timer(0.1, client.abort).start()
    with pytest.raises(ConnectionLost):
        while not client.ptp_arrived():
            client.joints()
    assert server.wait_for_end()
    assert set(server.lines[before:]) <= {"getJointsPositions"}
    client.close()
