"""The real-time controller as a process of a real graph: its launch file, sockets, signals and exit codes."""

from __future__ import annotations

import signal

import pytest
from controller_rig import MOVE_S, run_robot

pytest.importorskip("rig_msgs.srv")
from std_msgs.msg import String

pytestmark = pytest.mark.ros


@pytest.fixture
def robot(ros, wait_until):
    return run_robot(ros, wait_until, "--port", "0", "--control-port", "0")


@pytest.mark.real
def test_from_the_launch_file_to_an_interrupt(ros, robot, wait_until, processes):
    modes = ros.record("kuka/mode", String)
    launched = ros.launch("kuka_control", "real_time_controller.launch", ip="127.0.0.1", port=robot.port, gui="false")
    wait_until(lambda: modes, MOVE_S, "the controller")
    asked = processes.start("rosservice", "call", "kuka/scaling_factor", "1.0")
    assert asked.wait(30.0) == 0 and "The scaling factor is 1." in asked.log_path.read_text()
    launched.send_signal(signal.SIGINT)
    assert launched.wait(30.0) == 0
    assert "Traceback" not in launched.log_path.read_text()
