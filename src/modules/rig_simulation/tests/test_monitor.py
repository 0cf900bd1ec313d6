"""The node simulation: what it shows of the simulated arm, and its parameters."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture
def controller(processes, wait_until):
    """A running simulated controller; yields a client of its control port."""
    from rig_simulation.control_port import ControlClient

    program = processes.start("rosrun", "rig_simulation", "sunrise_controller.py", "--port", "0", "--control-port", "0")
    wait_until(lambda: b"control port" in program.log_path.read_bytes(), 30.0, "the controller")
    port = int(program.log_path.read_text().split("\n")[0].rsplit(":", 1)[1])
    with ControlClient("127.0.0.1", port, 30.0) as client:
        client.port = client._address[1]
        yield client


def test_the_flange_the_status_and_the_key(ros, controller, wait_until):
    import rospy
    from diagnostic_msgs.msg import DiagnosticStatus
    from geometry_msgs.msg import PoseStamped
    from std_srvs.srv import Trigger

    poses = ros.record("simulation/flange", PoseStamped)
    status = ros.record("simulation/status", DiagnosticStatus)
    ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={controller.port}", "_world_port:=0")
    poses.wait(10, 30.0)
    assert poses[-1].header.frame_id == "kuka/base_frame"
    assert abs(poses[-1].pose.position.z - 1.301) < 1e-9
    assert abs(poses[-1].pose.orientation.w - 1.0) < 1e-9
    assert abs((poses[-1].header.stamp - rospy.Time.now()).to_sec()) < 30.0
    assert status.wait(1, 30.0)[-1].level == DiagnosticStatus.OK
    values = {v.key: v.value for v in status[-1].values}
    assert (values["mode"], values["stops"], values["goals"], values["safety_stop"]) == ("idle", "0", "0", "")

    rospy.wait_for_service("simulation/release", 30.0)
    release = rospy.ServiceProxy("simulation/release", Trigger)
    back_off = rospy.ServiceProxy("simulation/back_off", Trigger)
    assert not release().success
    assert not back_off().success
    controller.ask("set_external_torque", value=[30, 0, 0, 0, 0, 0, 0])
    wait_until(lambda: status[-1].level == DiagnosticStatus.WARN, 15.0, "the stop")
    assert "joint 1 is 30.0 Nm" in status[-1].message
    assert back_off().success
    controller.ask("set_external_torque", value=[0] * 7)
    assert release().success
    wait_until(lambda: status[-1].level == DiagnosticStatus.OK, 15.0, "the release")


def test_the_stamp_tells_when_the_arm_stood_there_by_the_arms_own_clock(ros, controller, wait_until):
    import rospy
    from geometry_msgs.msg import PoseStamped

    from rig_simulation.control_port import ControlPort

    state = {**controller.ask("state"), "time": -1e6, "age": 1000.0}
    poses = ros.record("simulation/flange", PoseStamped)
    with ControlPort({"state": lambda: state}) as port:
        ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={port.port}", "_world_port:=0")
        poses.wait(1, 30.0)
        assert abs((rospy.Time.now() - poses[-1].header.stamp).to_sec() - 1000.0) < 30.0


def test_without_a_controller_it_says_so_and_waits(ros, free_port):
    from diagnostic_msgs.msg import DiagnosticStatus

    status = ros.record("simulation/status", DiagnosticStatus)
    node = ros.run("rig_simulation", "simulation_node.py", f"_arm_port:={free_port()}", "_world_port:=0")
    assert status.wait(2, 30.0)[0].level == DiagnosticStatus.ERROR
    assert "does not answer" in status[0].message
    assert node.poll() is None


@pytest.mark.parametrize(
    ("argument", "sentence"),
    [("_leap_port:=-1", "~leap_port is -1"), ("_prt:=5", "~prt"), ("_world_rate:=-1", "~world_rate")],
)
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("rig_simulation", "simulation_node.py", argument)
    assert node.wait(30.0) == 1
    log = node.log_path.read_text()
    assert sentence in log
    assert "Traceback" not in log
