"""The whole client against the simulated controller, which shares none of the client's code, in virtual time."""

import numpy as np
import pytest

from common import clock
from common.poses import translation
from kst.client import KstClient, KstMode
from kst.codec import Feedback
from kst.errors import ConnectionLost, MotionInterrupted, ReplyTimeout, WrongMode
from kst.session import ARRIVED_RAD, KstTiming
from rig_simulation.control_port import ControlClient
from rig_simulation.devices.sunrise.arm import ArmSettings, SimulatedArm
from rig_simulation.devices.sunrise.robot import Robot
from rig_simulation.devices.sunrise.server import ServerSettings, SunriseServer
from rig_simulation.files import read_urdf

WAITS = KstTiming()
TOOL = translation(0.0, 0.0, 0.106)
ABOVE_ZERO = np.array([0.1, -0.1, 0.05, -0.2, 0.1, 0.2, -0.1])
ROBOT = Robot(read_urdf("LBR7R800", "MF_elektrisch"))


class Rig:
    """A simulated controller, its truth, and clients of it."""

    def __init__(self, wires, settings):
        self._wires = wires
        with wires.scheduler.in_group("robot"):
            server = SunriseServer(SimulatedArm(ROBOT, ArmSettings()), settings, "127.0.0.1", 0, 0)
            clock.Thread(target=server.run, name="robot", daemon=True).start()
        self.port, self.ask = server.port, ControlClient("127.0.0.1", server.control_port).ask

    def connect(self, limits=None, **waits):
        return KstClient.connect("127.0.0.1", self.port, TOOL, limits, timing=KstTiming(**waits))

    def state(self, name):
        return self.ask("state")[name]

    def die(self):
        self._wires.scheduler.kill("robot")
        self._wires.end("robot")


@pytest.fixture
def start(wires):
    """Starts a simulated controller with other settings."""
    return lambda **settings: Rig(wires, ServerSettings(**settings))


@pytest.fixture
def rig(start):
    """A simulated controller."""
    return start()


def until(condition, seconds):
    """Waits until the condition holds, at most so many seconds."""
    deadline = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < deadline
        clock.sleep(0.004)


def stream(client, feedback, q_from, q_to, count=25):
    """Sends goals in small steps and returns the last result."""
    for fraction in np.linspace(0.0, 1.0, count):
        result = client.servo(q_from + fraction * (q_to - q_from), feedback)
    return result


def test_a_motion_whose_final_word_is_lost_ends_by_its_joints_and_the_next_one_is_paired(rig, takes):
    client = rig.connect()
    q = client.joints()
    rig.ask("fault", name="unfinished")
    for goal, seconds in ((q + 0.05, 2.0 + WAITS.reply), (q, 0.04)):
        client.start_ptp_joints(goal, 0.5)
        while np.max(np.abs(client.joints() - goal)) > ARRIVED_RAD:
            clock.sleep(0.004)
        with takes(seconds):
            until(lambda: client.joints() is not None and client.ptp_arrived(), 5.0)
        np.testing.assert_allclose(client.joints(), goal, atol=2e-3)
        rig.ask("fault", name="unfinished", on=False)


def test_getters_motion_and_close(rig):
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
    assert not rig.state("connected")


def test_a_motion_without_waiting_for_it(rig):
    client = rig.connect()
    client.start_ptp_joints(ABOVE_ZERO, 0.2)
    with pytest.raises(WrongMode):
        client.pose()
    seen = []

    def arrived():
        seen.append(client.joints()[3])
        return client.ptp_arrived()

    until(arrived, 5.0)
    assert len(seen) > 100 and np.all(np.diff(seen) <= 1e-9)
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


@pytest.mark.parametrize(("window", "resent"), [(0.003, 0), (0.03, 5)])
def test_a_server_that_wipes_commands(start, window, resent):
    client = start(wiped_window=window).connect()
    client.ptp_joints(ABOVE_ZERO, 1.0, timeout=30.0)
    for _ in range(3):
        assert client.external_torques().shape == (7,)
    client.start_joint_servo()
    client.servo(client.joints())
    client.stop_joint_servo()
    np.testing.assert_allclose(client.joints(), ABOVE_ZERO, atol=1e-3)
    assert (client.counts.resent, client.counts.stray) == (resent, 0)


def test_a_torque_ends_a_guarded_motion_and_the_next_one_goes_on(rig):
    client = rig.connect()
    assert client.knows_guarded_ptp()
    ranges = np.tile((-10.0, 10.0), (7, 1))
    client.start_ptp_joints(ABOVE_ZERO, 0.1, ranges)
    clock.sleep(0.5)
    rig.ask("set_external_torque", value=[0.0, 12.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(MotionInterrupted) as caught:
        until(client.ptp_arrived, 1.0)
    np.testing.assert_allclose(caught.value.torques, [0.0, 12.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert not any(rig.state("velocities")) and client.joints()[3] > ABOVE_ZERO[3] + 0.05
    rig.ask("set_external_torque", value=[0.0] * 7)
    client.start_ptp_joints(ABOVE_ZERO, 0.5, ranges)
    until(client.ptp_arrived, 10.0)
    assert client.counts.stray == client.counts.missed == 0


@pytest.mark.parametrize("longer", [False, True])
def test_a_server_that_freezes_is_regained_or_left_in_order(start, takes, longer):
    rig = start(deaf_after_lost_client=True)
    client = rig.connect()
    client.start_joint_servo()
    rig.ask("fault", name="half_open")
    with takes(WAITS.silence if longer else 9.0):
        with pytest.raises(ReplyTimeout):
            client.servo(np.zeros(7), Feedback.JOINTS)
        if longer:
            with pytest.raises(ConnectionLost):
                while client.silence(0.05):
                    pass
        else:
            clock.Timer(9.0 - WAITS.servo_reply, rig.ask, ["fault"], {"name": "half_open", "on": False}).start()
            while client.silence(0.05):
                pass
    if longer:
        client.close()
        rig.ask("fault", name="half_open", on=False)
        clock.sleep(0.1)
        assert not rig.state("connected"), "it has heard the farewell"
        client = rig.connect()
    else:
        client.stop_joint_servo()
    assert client.mode is KstMode.IDLE
    client.ptp_joints(ABOVE_ZERO, 0.5, timeout=20.0)
