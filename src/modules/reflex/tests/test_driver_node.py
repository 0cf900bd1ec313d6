"""The node with the simulated hand, in virtual time; and how it ends."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_srvs.srv import Empty

from reflex_msgs.msg import FingerPressure, Hand, RadianServoCommands, RawServoCommands
from reflex_msgs.srv import SetSpeed, SetTactileThreshold
from simulated.hand_wire import HandWire

pytestmark = pytest.mark.ros

PREFIX = "/reflex_takktile/"
PACKET_S, SILENCE_S, LOOP_S = 0.025, 0.5, 0.01
"""Between two packets, the driver's parameter silence_time, and what driver and wire take at most."""


@pytest.fixture
def wire(ros):
    with HandWire() as wire:
        yield wire


@pytest.fixture
def driver(ros, wire, tmp_path):
    """Launches the driver, whose calibration is kept in a folder of the test."""
    return ros.launch("reflex", "reflex_takktile.launch", eth="lo", calibration_folder=tmp_path / "calibration")


class Diagnosis:
    """What the driver reports on /diagnostics."""

    def __init__(self, ros):
        self._arrays = ros.record("/diagnostics", DiagnosticArray)

    def __call__(self):
        """The next report."""
        (status,) = self._arrays.wait(len(self._arrays) + 1, 0.6)[-1].status
        return status

    def value(self, key):
        return {v.key: v.value for v in self().values}[key]


@pytest.fixture
def diagnosis(ros):
    return Diagnosis(ros)


@pytest.fixture
def states(ros):
    return ros.record(PREFIX + "hand_state", Hand)


def call(name, service_type, *args):
    rospy.wait_for_service(PREFIX + name, 5.0)
    return rospy.ServiceProxy(PREFIX + name, service_type)(*args)


def publisher(ros, name, kind):
    made = rospy.Publisher(PREFIX + name, kind, queue_size=1)
    ros.wait_until(made.get_num_connections, 1.0, "the driver's subscription")
    return made


def test_state_commands_services_and_exit(ros, wire, driver, states, diagnosis, tmp_path):
    joints = ros.record("joint_states", JointState)
    states.wait(1, 1.0)
    clock.sleep(1.0)
    assert 39 <= len(states) <= 42 and [m.error_state for m in states[-1].motor] == ["0x00"] * 4
    assert joints[-1].name[:3] == ["reflex/preshape_1", "reflex/preshape_2", "reflex/proximal_joint_1"]

    call("calibrate_fingers", Empty)
    call("calibrate_tactile", Empty)
    ros.wait_until(lambda: diagnosis.value("calibration") == "succeeded", 8.0, "the calibration")
    assert len(list((tmp_path / "calibration").glob("*.yaml"))) == 2
    assert max(abs(p) for f in states[-1].finger for p in f.pressure) < 5

    commands = publisher(ros, "radian_hand_command", RadianServoCommands)
    commands.publish([2.0, 2.0, 1.8, 0.3])
    clock.sleep(1.0)  # at 3 rad/s
    assert [m.joint_angle for m in states[-1].motor] == pytest.approx([2.0, 2.0, 1.8, 0.3], abs=0.02)
    assert joints[-1].position[0] == pytest.approx(0.3, abs=0.02)
    commands.publish([float("nan"), 0.0, 0.0, 0.0])
    clock.sleep(0.5)
    assert diagnosis.value("refused") == "1" and states[-1].motor[1].joint_angle == pytest.approx(2.0, abs=0.02)

    call("set_speed", SetSpeed, [1.0, 1.0, 1.0, 1.0])
    clock.sleep(PACKET_S + LOOP_S)
    assert wire.hand.state()["speed_settings"] == [118, 1142, 118, 1149]
    with pytest.raises(rospy.ServiceException, match="refused"):
        call("set_speed", SetSpeed, [float("inf"), 1.0, 1.0, 1.0])

    call("set_tactile_threshold", SetTactileThreshold, [FingerPressure([5] * 9)] * 3)
    wire.hand.press(finger=1, cell=2, value=15)
    clock.sleep(PACKET_S + LOOP_S)
    assert states[-1].finger[1].contact[2]

    raw = publisher(ros, "raw_hand_command", RawServoCommands)
    goals = [position + 1 for position in wire.hand.state()["positions"]]
    raw.publish(goals)
    clock.sleep(PACKET_S + LOOP_S)
    assert wire.hand.state()["goals"] == goals

    call("zero_pose", Empty)
    clock.sleep(0.5)  # in which the tendons are let out
    assert states[-1].motor[0].joint_angle == pytest.approx(0.0, abs=0.02)
    call("disable_torque", Empty)
    clock.sleep(PACKET_S + LOOP_S)
    assert wire.hand.state()["torque"] == [False] * 4
    with pytest.raises(rospy.ServiceException, match="Torque is off"):
        call("calibrate_fingers", Empty)
    call("set_speed", SetSpeed, [3.0, 3.0, 3.0, 2.0])
    assert diagnosis.value("lost") == "0"

    driver.send_signal(signal.SIGINT)
    clock.sleep(0.2)
    assert driver.poll() == 0 and driver.nodes[0].returncode == 0
    assert wire.hand.state()["mode"] == [0] * 4
    assert "Traceback" not in driver.log_path.read_text()


def test_a_calibration_that_cannot_be_written_still_holds(ros, wire, states, tmp_path):
    (tmp_path / "file").write_text("no folder")
    folder = tmp_path / "file" / "deeper"
    launch = ros.launch("reflex", "reflex_takktile.launch", eth="lo", calibration_folder=folder)
    states.wait(5, 1.0)
    call("calibrate_fingers", Empty)
    ros.wait_until(lambda: "Cannot write" in launch.log_path.read_text(), 8.0, "the sentence")
    publisher(ros, "radian_hand_command", RadianServoCommands).publish([1.0, 1.0, 1.0, 0.0])
    clock.sleep(1.0)
    assert states[-1].motor[0].joint_angle == pytest.approx(1.0, abs=0.02)


@pytest.fixture
def end_of(ros, wire, tmp_path):
    """Loads the shipped parameters; the function sets and removes some, and lets the driver run to its end."""
    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "reflex_takktile.yaml").read_text())
    values.update(network_interface="lo", port=11333, calibration_folder=str(tmp_path))

    def end(**changes) -> tuple[int, str]:
        merged = {k: v for k, v in {**values, **changes}.items() if v is not None}
        rospy.set_param("/reflex_takktile_driver", merged)
        driver = ros.run("reflex", "reflex_takktile_driver.py")
        return driver.wait(20.0), driver.log_path.read_text()

    return end


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"network_interface": "eth77"}, "The network interface 'eth77' does not exist; interfaces with an IPv4"),
        ({"port": "many"}, "reflex_takktile_driver/port is 'many', but must be a whole number in [1, 65535]."),
        ({"travel": [4.0, 3.6, 3.6, 1.75]}, "travel of f1 is 4 rad; the hand has 3.6 rad at most."),
    ],
)
def test_ends_with_a_sentence(end_of, changes, sentence):
    code, output = end_of(**changes)
    assert code == 1 and sentence in output and "Traceback" not in output
