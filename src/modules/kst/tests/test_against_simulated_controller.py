"""The whole client against the simulated controller, a program of its own that shares none of the client's code."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from common.poses import translation
from kst.client import KstClient, KstMode
from kst.codec import Feedback
from kst.errors import ConnectionLost, MotionRefused, NoServer, ReplyTimeout, ServerBusy, WrongMode
from kst.limits import JointLimits
from kst.session import KstTiming
from rig_simulation.control_port import ControlClient

PROGRAM = Path(__file__).parents[2] / "rig_simulation" / "scripts" / "sunrise_controller.py"
TOOL = translation(0.0, 0.0, 0.106)
ABOVE_ZERO = np.array([0.1, -0.1, 0.05, -0.2, 0.1, 0.2, -0.1])
WAITS = {"connect_settle": 0.0, "tool_settle": 0.0, "servo_reply": 20.0, "reply": 20.0}
READY = re.compile(
    r"^sunrise_controller: listening on 127\.0\.0\.1:(\d+), control port 127\.0\.0\.1:(\d+)$", re.MULTILINE
)


class Rig:
    """A simulated controller, its truth, and clients of it."""

    def __init__(self, port, truth):
        self.port, self._truth, self.clients = port, truth, []

    def connect(self, limits=None, **waits):
        timing = KstTiming(**{**WAITS, **waits})
        self.clients.append(KstClient.connect("127.0.0.1", self.port, TOOL, limits, timeout=10.0, timing=timing))
        return self.clients[-1]

    def ask(self, do, **fields):
        return self._truth.ask(do, **fields)

    def state(self, name):
        return self.ask("state")[name]


@pytest.fixture
def start(processes, wait_until):
    """Starts a simulated controller with more options, for one test."""
    rigs = []

    def start(*options):
        command = [sys.executable, str(PROGRAM), "--port", "0", "--control-port", "0", *options]
        process = processes.start(*command)
        ready = wait_until(lambda: READY.search(process.log_path.read_text()), 30.0, "the simulated controller")
        rigs.append((Rig(int(ready[1]), ControlClient("127.0.0.1", int(ready[2]), 10.0)), process))
        return rigs[-1][0]

    yield start
    for rig, process in rigs:
        for client in rig.clients:
            client.close()
        rig._truth.close()
        processes.end(process)


@pytest.fixture
def rig(start):
    """A simulated controller."""
    return start()


def stream(client, feedback, q_from, q_to, count=25):
    """Sends goals in small steps and returns the last result."""
    for fraction in np.linspace(0.0, 1.0, count):
        result = client.servo(q_from + fraction * (q_to - q_from), feedback)
    return result


def test_a_motion_whose_final_word_is_lost_ends_by_its_joints_and_the_next_one_is_paired(rig, wait_until):
    client = rig.connect(reply=2.0)  # so long the arm has to stand
    q = client.joints()
    rig.ask("fault", name="unfinished")
    for goal in (q + 0.05, q):
        client.start_ptp_joints(goal, 0.5)
        wait_until(lambda: client.joints() is not None and client.ptp_arrived(), 10.0, "the end of the motion")
        np.testing.assert_allclose(client.joints(), goal, atol=2e-3)
        rig.ask("fault", name="unfinished", on=False)


def test_getters_motion_and_close(rig, wait_until):
    client = rig.connect()
    np.testing.assert_allclose(client.joints(), np.zeros(7), atol=1e-9)
    np.testing.assert_allclose(client.pose(), translation(0.0, 0.0, 1.301 + 0.106), atol=1e-6)
    for getter, size in (
        (client.external_torques, 7),
        (client.measured_torques, 7),
        (client.force, 3),
        (client.moment, 3),
    ):
        assert getter().shape == (size,)
    client.set_blue(True)
    client.set_pin(1, True)
    assert client.pin(3) is True
    client.ptp_joints(ABOVE_ZERO, 0.5, timeout=30.0)
    np.testing.assert_allclose(client.joints(), ABOVE_ZERO, atol=1e-6)
    np.testing.assert_allclose(rig.state("joints"), ABOVE_ZERO, atol=1e-6)
    flange = np.array(rig.state("flange"))
    np.testing.assert_allclose(client.pose(), flange @ TOOL, atol=1e-6)
    client.close()
    wait_until(lambda: not rig.state("connected"), 10.0, "the end of the connection")


def test_a_motion_without_waiting_for_it(rig, wait_until):
    client = rig.connect()
    client.start_ptp_joints(ABOVE_ZERO, 0.2)
    with pytest.raises(WrongMode):
        client.pose()
    seen = []

    def arrived():
        seen.append(client.joints()[3])
        return client.ptp_arrived()

    wait_until(arrived, 30.0, "the arrival")
    assert len(seen) > 3 and np.all(np.diff(seen) <= 1e-9)
    np.testing.assert_allclose(client.joints(), ABOVE_ZERO, atol=1e-6)
    assert client.counts.stray == client.counts.missed == 0


def test_every_servo_goal_and_a_still_arm_after_the_stop(rig):
    client = rig.connect()
    client.ptp_joints(ABOVE_ZERO, 1.0, timeout=30.0)
    client.start_joint_servo()
    assert rig.state("mode") == "servo"
    q = ABOVE_ZERO
    for feedback, shape in [
        (Feedback.DONE, None),
        (Feedback.JOINTS, (7,)),
        (Feedback.EXTERNAL_TORQUES, (7,)),
        (Feedback.MEASURED_TORQUES, (7,)),
        (Feedback.POSE, (4, 4)),
        (Feedback.FORCE, (3,)),
        (Feedback.NOTHING, None),
    ]:
        result = stream(client, feedback, q, q + 0.002)
        q = q + 0.002
        assert (None if result is None else result.shape) == shape
    np.testing.assert_allclose(client.joints(), q, atol=0.02)
    client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    np.testing.assert_allclose(client.pose(), np.array(rig.state("flange")) @ TOOL, atol=1e-3)
    assert rig.state("goals") == 25 * 7
    client.start_joint_servo()
    client.stop_joint_servo()


@pytest.mark.parametrize("window", ["0.003", "0.03"])
def test_a_server_that_wipes_commands(start, window):
    client = start("--wiped-window", window).connect(reply=1.0)
    client.ptp_joints(ABOVE_ZERO, 1.0, timeout=30.0)
    for _ in range(3):
        assert client.external_torques().shape == (7,)
    client.start_joint_servo()
    client.servo(client.joints())
    client.stop_joint_servo()
    np.testing.assert_allclose(client.joints(), ABOVE_ZERO, atol=1e-3)
    if window == "0.03":
        assert client.counts.resent > 0
    assert client.counts.stray == 0


def test_a_safety_stop_only_delays_the_arrival(rig, wait_until):
    client = rig.connect()
    client.start_ptp_joints(ABOVE_ZERO, 0.1)
    wait_until(lambda: max(map(abs, rig.state("velocities"))) > 0.01, 10.0, "the motion")
    rig.ask("set_external_torque", value=[0.0, 40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    wait_until(lambda: rig.state("safety_stop") and not any(rig.state("velocities")), 10.0, "the safety stop")
    assert not client.ptp_arrived()
    assert client.joints()[3] > ABOVE_ZERO[3]
    rig.ask("set_external_torque", value=[0.0] * 7)
    rig.ask("release")
    wait_until(client.ptp_arrived, 30.0, "the arrival")
    np.testing.assert_allclose(client.joints(), ABOVE_ZERO, atol=1e-6)


def test_after_a_refused_goal_the_poses_are_again_those_of_the_tool(rig):
    client = rig.connect(limits=JointLimits(np.full(7, -4.0), np.full(7, 4.0)))
    with pytest.raises(MotionRefused):
        client.ptp_joints([3.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.5, timeout=30.0)
    np.testing.assert_allclose(client.pose(), np.array(rig.state("flange")) @ TOOL, atol=1e-6)
    client.ptp_joints(ABOVE_ZERO, 1.0, timeout=30.0)


def test_closing_in_the_servo_mode_leaves_it(rig, wait_until):
    client = rig.connect()
    client.start_joint_servo()
    client.close()
    wait_until(lambda: rig.state("mode") == "idle", 10.0, "the end of the servo mode")
    wait_until(lambda: not rig.state("connected"), 10.0, "the end of the connection")


def test_a_second_client_finds_the_server_busy(rig):
    rig.connect()
    with pytest.raises(ServerBusy):
        KstClient.connect("127.0.0.1", rig.port, timing=KstTiming(connect_settle=0.0, reply=0.3), timeout=0.6)


def test_the_program_dies(start, processes):
    rig = start()
    client = rig.connect()
    client.start_joint_servo()
    processes.end_all()
    with pytest.raises(ConnectionLost):
        for _ in range(1000):
            client.servo(np.zeros(7), Feedback.JOINTS)
    with pytest.raises(NoServer):
        KstClient.connect("127.0.0.1", rig.port)


@pytest.mark.parametrize("longer", [False, True])
def test_a_server_that_freezes_is_regained_or_left_in_order(start, wait_until, longer):
    rig = start("--deaf-after-lost-client")
    client = rig.connect(silence=1.0 if longer else 60.0)
    client.start_joint_servo()
    rig.ask("fault", name="half_open")
    patient = client._session.timing
    client._session.timing = replace(patient, servo_reply=0.05, reply=0.5)
    with pytest.raises(ReplyTimeout):
        client.servo(client.joints(), Feedback.JOINTS)
    if longer:
        with pytest.raises(ConnectionLost):
            while client.silence(0.05):
                pass
        client.close()
        rig.ask("fault", name="half_open", on=False)
        wait_until(lambda: not rig.state("connected"), 10.0, "the server to hear the farewell")
        client = wait_until(lambda: connected(rig), 20.0, "the server to serve another client")
    else:
        rig.ask("fault", name="half_open", on=False)
        wait_until(lambda: client.silence(0.05) == 0.0, 10.0, "the server to answer again")
        client._session.timing = patient
        client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    client.ptp_joints(ABOVE_ZERO, 0.5, timeout=20.0)


def connected(rig):
    try:
        return rig.connect()
    except (NoServer, ServerBusy):
        return None
