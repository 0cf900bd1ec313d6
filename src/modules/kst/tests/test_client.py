"""What the client says, refuses and reports, against a scripted server."""

import itertools
import math

import numpy as np
import pytest

from common import clock
from common.poses import translation
from kst.application import ApplicationSettings
from kst.client import KstClient, KstMode
from kst.codec import Feedback
from kst.errors import (
    BadJoints,
    BadVelocity,
    ConnectionLost,
    ForeignServer,
    MotionInterrupted,
    MotionRefused,
    NoServer,
    ReplyTimeout,
    ServerBusy,
    ToolNotAttached,
    UnexpectedReply,
    WrongMode,
)
from kst.session import KstTiming
from simulated.wires import DELAY_S

HOME = np.array([-0.7854, 0.5236, 0.0, -1.39626, 0.0, 1.22173, 0.0])
GOAL = "jp_-0.7854_0.5236_0.0_-1.39626_0.0_1.22173_0.0_"
WAITS = KstTiming()

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


def test_connecting_attaches_the_tool_and_closing_says_end(server, takes):
    tool = translation(0.0, 0.0, 0.106)
    with takes(WAITS.connect_settle + WAITS.tool_settle):
        client = KstClient.connect("127.0.0.1", server.port, tool)
    with takes(0.0), client:
        assert client.mode is KstMode.IDLE
        assert client.round_trip == pytest.approx(2.0 * DELAY_S)
    assert server.has_ended()
    assert server.words() == ["TFtrans", "end"]
    assert [float(f) for f in server.lines[0].split("_")[1:-1]] == [0.0, 0.0, 106.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(("host", "seconds"), [("127.0.0.1", 0.0), ("192.0.2.1", 5.0)])
def test_nobody_listens(wires, takes, host, seconds):
    """Reported in https://github.com/jonaitken/KUKA-IIWA-API/issues/8: a firewall swallows the connection. Tried: an
    address that is silent.
    """
    with takes(seconds), pytest.raises(NoServer) as caught:
        KstClient.connect(host, 30001)
    assert caught.value.address == f"{host}:30001"


@pytest.mark.parametrize("reset", [False, True])
def test_the_server_ends_at_once(server, takes, reset):
    server.answers.clear()
    clock.Timer(WAITS.connect_settle + 0.1, server.end, [reset]).start()
    with takes(WAITS.connect_settle + 0.1), pytest.raises(NoServer):
        KstClient.connect("127.0.0.1", server.port)


def test_an_open_port_that_stays_silent(server, takes):
    server.answers.clear()
    with takes(WAITS.connect_settle + 5.0), pytest.raises(ServerBusy):
        KstClient.connect("127.0.0.1", server.port)
    assert server.has_ended()


@pytest.mark.parametrize(("answer", "seconds"), [(b"", 3 * (WAITS.reply + 2 * WAITS.quiet)), (b"nak\n", 0.0)])
def test_a_server_that_does_not_attach_the_tool(server, takes, answer, seconds):
    """Reported in https://github.com/Modi1987/KST-Kuka-Sunrise-Toolbox/issues/4,
    https://github.com/Modi1987/KST-Kuka-Sunrise-Toolbox/issues/15: connected, then the tool is not attached.
    Tried: a server that does not.
    """
    server.answers["TFtrans"] = answer
    with takes(WAITS.connect_settle + seconds), pytest.raises(ToolNotAttached):
        KstClient.connect("127.0.0.1", server.port)
    assert server.has_ended()
    assert server.lines[-1] == "end"


@pytest.mark.parametrize("count", [1, 50])
@pytest.mark.parametrize(
    ("application", "expected", "program"),
    [
        (None, "the toolbox's server", "MatlabToolboxServer"),
        (ApplicationSettings(), "the robot application", "LeapRigServer"),
    ],
)
def test_something_else_listens_there(server, count, application, expected, program):
    web = b"HTTP/1.1 400 Bad Request\r\nServer: x\r\n\r\n" * count
    server.answers = {"TFtrans": web, "lrHello": web}
    with pytest.raises(ForeignServer, match=f"is not {expected} .* and the version of {program}") as caught:
        KstClient.connect("127.0.0.1", server.port, application=application)
    assert caught.value.address == f"127.0.0.1:{server.port}"
    assert caught.value.answer.startswith(b"HTTP/1.1 400 Bad Request")


@pytest.mark.parametrize("late", [b"done\0\n", b"yes\n"])
def test_a_toolbox_with_one_foreign_line_is_the_toolbox(server, late):
    server.answers["TFtrans"] = late + b"done\n"
    KstClient.connect("127.0.0.1", server.port).close()


def test_bytes_without_a_line_end_keep_nobody_waiting_for_ever(server, connect):
    client, flooding = connect(), [True]

    def flood():
        while flooding[0]:
            server.push(b"x" * 4096)

    clock.Thread(target=flood, daemon=True).start()
    with pytest.raises(ReplyTimeout):
        client.joints()
    flooding[0] = False


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


def test_a_ptp_motion_and_its_two_answers(server, connect):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    assert client.mode is KstMode.PTP
    assert not client.ptp_arrived()
    assert server.lines[1:] == ["jRelVel_0.25_", GOAL, "doPTPinJS"]
    server.push(b"done\n")
    assert client.ptp_arrived()
    assert client.mode is KstMode.IDLE
    with pytest.raises(WrongMode):
        client.ptp_arrived()


def test_lights_during_a_motion_do_not_end_it(server, connect):
    server.answers["blueOn"] = b"done\n"
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    client.set_blue(True)
    assert not client.ptp_arrived()
    server.once("blueOn", b"done\ndone\n")
    client.set_blue(True)
    assert client.ptp_arrived()


def test_a_motion_that_does_not_end_in_time_names_the_joint_that_is_farthest(server, connect, takes):
    """Reported in https://github.com/Modi1987/iiwaPy/issues/2: a motion waits for its end for ever. Tried: no second
    `done`.
    """
    client = connect()
    with takes(12.0), pytest.raises(ReplyTimeout, match=r"joint 4 .* 5\.73 deg"):
        client.ptp_joints(HOME + 0.1 * np.eye(7)[3], 0.25, timeout=12.0)
    assert client.mode is KstMode.PTP
    server.push(b"done\n")
    assert client.ptp_arrived()


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


def test_a_refusal_is_not_made_good_by_a_later_word(server, connect):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    server.push(b"nak\ndone\n")
    with pytest.raises(MotionRefused):
        client.ptp_arrived()


RANGES = np.tile((-10.0, 10.0), (7, 1))


@pytest.mark.parametrize("last", [b"interrupted\n", b"inter"])
def test_a_motion_that_a_torque_ends_tells_the_torques_where_the_arm_stands(server, connect, last):
    server.answers["doPTP!inJS"] = b"done\n"
    client = connect()
    client.start_ptp_joints(HOME + 0.1, 0.25, RANGES)
    assert server.words()[2:] == ["jRelVel", "jp", "doPTP!inJS"]
    assert not client.ptp_arrived()
    server.push(last)
    if last == b"inter":  # torn
        assert not client.ptp_arrived()
        server.push(b"rupted\n")
    with pytest.raises(MotionInterrupted) as caught:
        client.ptp_arrived()
    np.testing.assert_allclose(caught.value.torques, np.arange(1, 8) / 10)
    assert client.mode is KstMode.IDLE
    assert server.words()[-1] == "Torques_ext_J", "the tool is still attached"
    assert client.counts.stray == client.counts.missed == 0


def test_torques_that_do_not_come_do_not_hide_the_end_of_a_motion(server, connect, takes):
    server.answers["doPTP!inJS"] = b"done\ninterrupted\n"
    client = connect()
    client.start_ptp_joints(HOME + 0.1, 0.25, RANGES)
    server.answers["Torques_ext_J"] = b""
    with takes(WAITS.reply), pytest.raises(MotionInterrupted) as caught:
        client.ptp_arrived()
    assert caught.value.torques is None
    np.testing.assert_array_equal(client.joints(), HOME)


def test_an_end_by_a_torque_that_is_never_told_is_no_arrival(server, connect):
    server.answers["doPTP!inJS"] = b"done\n"
    client = connect()
    client.start_ptp_joints(HOME + 0.1, 0.25, RANGES)
    for _ in range(100):
        client.joints()
        assert not client.ptp_arrived()
        clock.sleep(0.1)
    server.push(b"interrupted\n")
    with pytest.raises(MotionInterrupted):
        client.ptp_arrived()


def test_a_server_is_asked_whether_it_knows_guarded_motions_by_one_that_does_not_move(server, connect, takes):
    server.answers["doPTP!inJS"] = b"done\ndone\n"
    client = connect()
    assert client.knows_guarded_ptp()
    assert server.lines[1:] == ["doPTP!inJS"]
    server.answers["doPTP!inJS"] = b""
    assert not client.knows_guarded_ptp()
    assert server.words()[-1] == "Torques_ext_J", "it answers other words"
    client.start_ptp_joints(HOME, 0.25)
    assert not client.ptp_arrived()
    assert client.counts.stray == 0


@pytest.mark.parametrize("answer", [b"done\n", b""])
def test_a_server_whose_main_thread_is_stuck_is_not_taken_for_an_old_one(server, connect, answer):
    client = connect()
    server.answers.update({"doPTP!inJS": answer, "Torques_ext_J": b""})
    with pytest.raises(ReplyTimeout if answer == b"" else UnexpectedReply):
        client.knows_guarded_ptp()


def test_a_tool_that_cannot_be_attached_again(server, connect):
    client = connect()
    server.answers["TFtrans"] = b""
    server.once("doPTPinJS", b"done\nnak\n")
    with pytest.raises(ToolNotAttached):
        client.ptp_joints(HOME, 0.25, timeout=10.0)


def test_the_servo_starts_where_the_arm_stands(server, connect, takes):
    """Reported in https://github.com/IFL-CAMP/iiwa_stack/issues/212: the first goal is zero: the arm rushes there.
    Tried: start of the servo.
    """
    client = connect()
    with takes(WAITS.servo_start):
        client.start_joint_servo()
    assert client.mode is KstMode.SERVO
    assert server.lines[1:] == ["getJointsPositions", GOAL, "startDirectServoJoints"]
    with takes(WAITS.quiet + WAITS.servo_stop):
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


def test_goals_without_answer_notice_the_end_of_the_link(server, connect):
    client = connect()
    client.start_joint_servo()
    server.end()
    with pytest.raises(ConnectionLost):
        client.servo(HOME, Feedback.NOTHING)


@pytest.mark.parametrize(("moving", "readings"), [(4, 6), (100, 10)])
def test_the_stop_waits_until_the_arm_stands_or_half_a_second(server, connect, moving, readings):
    client = connect()
    client.start_joint_servo()
    before = len(server.lines)
    server.once("getJointsPositions", *(b"%f_0.0_0.0_0.0_0.0_0.0_0.0_\n" % (0.1 * i) for i in range(moving)))
    client.stop_joint_servo()
    assert server.words()[before:] == ["getJointsPositions"] * readings + ["stopDirectServoJoints"]


@pytest.mark.parametrize(
    ("says", "does"),
    [
        (lambda server: server.once("jp", b"nak\ndone\n"), lambda client: client.servo(HOME)),
        (lambda server: server.push(b"nak\n"), lambda client: client.servo(HOME, Feedback.NOTHING)),
        (lambda server: server.once("stopDirectServoJoints", b"done\nnak\n"), lambda client: client.stop_joint_servo()),
    ],
)
def test_an_unasked_nak_ends_the_servo_mode(server, connect, says, does):
    client = connect()
    client.start_joint_servo()
    says(server)
    with pytest.raises(MotionRefused):
        does(client)
    assert client.mode is KstMode.IDLE
    assert server.words()[-2:] == ["stopDirectServoJoints", "TFtrans"]


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
    for goal, feedback in itertools.product((client.servo, client.stream), Feedback):
        with pytest.raises(WrongMode):
            goal(HOME, feedback)
    for of_servo_mode in (client.stop_joint_servo, client.stream_joints):
        with pytest.raises(WrongMode):
            of_servo_mode()
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


@pytest.mark.hazard(11)
@pytest.mark.parametrize(
    "q", [[math.nan] * 7, [math.inf] + [0.0] * 6, [0.0] * 6, [0.0, 2.2, 0.0, 0.0, 0.0, 0.0, 0.0], [600.0] * 7, None]
)
def test_bad_joints_never_leave(server, connect, q):
    """Reported in https://github.com/IFL-CAMP/iiwa_stack/issues/214: goals beyond the joint ranges end the
    application. Tried: such goals.
    """
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
    assert server.has_ended()
    assert server.lines[-2:] == ["stopDirectServoJoints", "end"]
    assert client.mode is KstMode.IDLE
    client.close()
    with pytest.raises(ConnectionLost):
        client.joints()


def test_a_server_that_was_given_up_hears_the_farewell(server, connect, takes):
    client = connect()
    client.start_joint_servo()
    server.freeze()
    with takes(WAITS.silence):
        with takes(WAITS.servo_reply), pytest.raises(ReplyTimeout):
            client.servo(HOME)
        with pytest.raises(ConnectionLost):
            while client.silence(0.05):
                pass
    with takes(WAITS.farewell):
        client.close()
    server.freeze(False)
    assert server.has_ended()
    assert server.lines[-2:] == ["stopDirectServoJoints", "end"]
    client.close()


@pytest.mark.parametrize("reset", [False, True])
def test_a_lost_link_stays_lost_and_closing_is_quiet(server, connect, reset):
    client = connect()
    server.end(reset)
    assert server.has_ended()
    for _ in range(3):
        with pytest.raises(ConnectionLost):
            client.joints()
    client.close()


def test_abort_from_another_thread_says_nothing_and_wakes_the_caller(server, connect, takes):
    client = connect()
    client.start_ptp_joints(HOME, 0.25)
    before = len(server.lines)
    clock.Timer(0.1, client.abort).start()
    with takes(0.1), pytest.raises(ConnectionLost):
        while not client.ptp_arrived():
            client.joints()
    assert server.has_ended()
    assert set(server.lines[before:]) <= {"getJointsPositions"}
    client.close()
