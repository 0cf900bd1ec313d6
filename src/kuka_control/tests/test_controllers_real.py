"""The real-time controller as a process of a real graph: its launch file, sockets, signals and exit codes."""

from __future__ import annotations

import signal

import pytest
from controller_rig import MOVE_S, PTP, REAL_TIME, SLOW, Node, quick_params, run_robot, set_params

pytestmark = pytest.mark.ros


@pytest.fixture
def robot(ros, wait_until):
    return run_robot(ros, wait_until, "--port", "0", "--control-port", "0")


def test_from_the_launch_file_to_an_interrupt(ros, robot, wait_until, processes):
    from std_msgs.msg import String

    modes = ros.record("kuka/mode", String)
    launched = ros.launch("kuka_control", "real_time_controller.launch", ip="127.0.0.1", port=robot.port, gui="false")
    wait_until(lambda: modes and modes[-1].data == "home", MOVE_S, "the arm at home")
    asked = processes.start("rosservice", "call", "kuka/scaling_factor", "1.0")
    assert asked.wait(30.0) == 0 and "The scaling factor is 1." in asked.log_path.read_text()
    launched.send_signal(signal.SIGINT)
    assert launched.wait(30.0) == 0
    wait_until(lambda: "the client ended the application" in robot.log, 5.0, "`end`")
    assert "Traceback" not in launched.log_path.read_text()


def test_the_emergency_exit_works_while_the_robot_hangs(ros, robot, wait_until, suspend):
    from std_msgs.msg import String

    quick_params(REAL_TIME, robot.port, **SLOW)
    node = Node(None, wait_until)
    node.modes = ros.record("kuka/mode", String)
    node.process = ros.run("kuka_control", REAL_TIME)
    node.wait_for_mode("homing", "home")
    suspend(robot.process.pid)
    try:
        assert node.call("exit_app_emergency", "exitAppEmergency").success
        assert node.wait_for_end(10.0) == 2
    finally:
        robot.process.send_signal(signal.SIGCONT)


def test_simulated_time_without_a_clock_is_said(ros, wait_until):
    import rospy

    rospy.set_param("use_sim_time", True)
    set_params(PTP)
    node = Node(ros.run("kuka_control", PTP), wait_until)
    assert node.wait_for_end(60.0) == 1
    assert "use_sim_time is true, but nobody publishes /clock within 10 s" in node.log and "Traceback" not in node.log
