"""The whole client against the simulated controller, which shares none of the client's code, in virtual time."""

import numpy as np
import pytest

from common import clock
from common.poses import translation
from kst.client import KstClient, KstMode
from kst.codec import Feedback
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
