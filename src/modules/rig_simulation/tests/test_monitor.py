"""The node simulation in virtual time: what it shows of the simulated arm, and its parameters."""

from __future__ import annotations

import math

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3
from std_srvs.srv import SetBool, Trigger

from rig_simulation.control_port import ControlClient, ControlPort

pytestmark = pytest.mark.ros

SEEN_S = 0.02  # from the node's question to the message in the test
STATUS_PERIOD_S, RETRY_PERIOD_S, START_S, REMIND_S = 0.1, 0.5, 5.0, 10.0


@pytest.fixture
def controller(ros):
    """A running simulated controller; yields a client of its control port, and that port."""
    ros.run("rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "16433")
    clock.sleep(0.1)
    with ControlClient("127.0.0.1", 16433, 1.0) as client:
        yield client, 16433


def test_the_flange_the_status_and_the_key(ros, controller):
    arm, port = controller
    poses = ros.record("simulation/flange", PoseStamped)
    status = ros.record("simulation/status", DiagnosticStatus)
    ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={port}", "_world_port:=0", "_flange_rate:=50")
    poses.wait(1, 1.0)
    clock.sleep(1.0)
    assert 50 <= len(poses) <= 52 and 8 <= len(status) <= 10, "every STATUS_PERIOD_S, with the next pose"
    assert poses[-1].header.frame_id == "kuka/base_frame"
    assert abs(poses[-1].pose.position.z - 1.301) < 1e-9
    assert abs(poses[-1].pose.orientation.w - 1.0) < 1e-9
    assert 0.0 <= (rospy.Time.now() - poses[-1].header.stamp).to_sec() < 0.02 + SEEN_S
    assert status[-1].level == DiagnosticStatus.OK
    values = {v.key: v.value for v in status[-1].values}
    assert (values["mode"], values["stops"], values["goals"], values["safety_stop"]) == ("idle", "0", "0", "")

    release = rospy.ServiceProxy("simulation/release", Trigger)
    back_off = rospy.ServiceProxy("simulation/back_off", Trigger)
    assert not release().success
    assert not back_off().success
    arm.ask("set_external_torque", value=[30, 0, 0, 0, 0, 0, 0])
    clock.sleep(STATUS_PERIOD_S + 2 * SEEN_S)
    assert status[-1].level == DiagnosticStatus.WARN and "joint 1 is 30.0 Nm" in status[-1].message
    assert back_off().success
    arm.ask("set_external_torque", value=[0] * 7)
    assert release().success
    clock.sleep(STATUS_PERIOD_S + 2 * SEEN_S)
    assert status[-1].level == DiagnosticStatus.OK


def test_a_hand_pushes_and_presses_the_enabling_switch(ros, controller):
    arm, port = controller
    node = ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={port}", "_world_port:=0")
    push = rospy.Publisher("simulation/hand_force", Vector3, queue_size=1)
    clock.sleep(0.5)
    push.publish(Vector3(60.0, 0.0, 0.0))
    clock.sleep(SEEN_S)
    assert "external torque" in arm.ask("state")["safety_stop"], "the force acts on the arm"
    push.publish(Vector3(0.0, math.nan, 0.0))
    clock.sleep(SEEN_S)
    assert "it is not applied" in node.log_path.read_text()
    enabling = rospy.ServiceProxy("simulation/enabling", SetBool)
    assert enabling(True).success and arm.ask("state")["enabling"] is True
    assert enabling(False).success and arm.ask("state")["enabling"] is False


def test_the_stamp_tells_when_the_arm_stood_there_by_the_arms_own_clock(ros, controller):
    arm, _ = controller
    state = {**arm.ask("state"), "time": -1e6, "age": 1000.0}
    poses = ros.record("simulation/flange", PoseStamped)
    with ControlPort({"state": lambda: state}) as port:
        ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={port.port}", "_world_port:=0")
        poses.wait(1, 1.0)
        assert 1000.0 <= (rospy.Time.now() - poses[-1].header.stamp).to_sec() < 1000.0 + 2 * SEEN_S


def test_without_a_controller_it_says_so_and_waits(ros):
    status = ros.record("simulation/status", DiagnosticStatus)
    node = ros.run("rig_simulation", "simulation_node.py", "_arm_port:=30001", "_world_port:=0")
    said = lambda: node.log_path.read_text().count("does not answer")  # noqa: E731
    clock.sleep(START_S)
    assert said() == 0 and len(status) == pytest.approx(START_S / RETRY_PERIOD_S, abs=1)
    assert {s.level for s in status} == {DiagnosticStatus.ERROR} and "does not answer" in status[0].message
    clock.sleep(2 * RETRY_PERIOD_S)
    assert said() == 1
    clock.sleep(REMIND_S)
    assert said() == 2 and node.poll() is None


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [("_leap_port:=-1", "~leap_port is -1"), ("_prt:=5", "~prt")],
)
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("rig_simulation", "simulation_node.py", argument)
    assert node.wait(1.0) == 1
    log = node.log_path.read_text()
    assert sentence in log and "Traceback" not in log
