"""A recorded motion on the simulated arm: agreed to, slowly first, through kuka/move."""

import io
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from common import clock
from leap_rig.recording import read

pytest.importorskip("rig_msgs.srv")
import rospy
from controller_rig import MOVE_S, Node, home_tool, run_robot, set_params, shifted
from std_msgs.msg import String

from common.ros.action_client import ActionClient
from common.ros.conversions import stamped_pose
from kuka_msgs.msg import MoveAction, MoveGoal
from leap_rig.recording.ros import record_program
from leap_rig.recording.ros.replay_program import _agrees

pytestmark = pytest.mark.ros
sys.path.append(str(Path(__file__).parents[2] / "kuka_control" / "tests"))


@pytest.fixture
def ros(virtual_graph, monkeypatch):
    git = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(stdout="abc"), TimeoutExpired=TimeoutError)
    monkeypatch.setattr(record_program, "subprocess", git)
    return virtual_graph


def test_the_arm_repeats_its_motion_only_when_the_operator_agrees(ros, tmp_path):
    robot = run_robot(ros, ros.wait_until, "--port", "0", "--control-port", "0", "--tool-weight")
    set_params("real_time_controller.py", ip="127.0.0.1", port=robot.port, velocity_ptp_slow=0.9, velocity_ptp_fast=0.9)
    node = Node(None, ros.wait_until)
    modes = node.modes = ros.record("kuka/mode", String)
    node.process = ros.run("kuka_control", "real_time_controller.py")
    recorder = ros.run("leap_rig", "record.py", f"{tmp_path}/run")
    node.wait_for_mode("home")
    client = ActionClient("kuka/move", MoveAction)
    assert client.wait_for_server(rospy.Duration(20.0))
    assert node.control(True).success
    ends = [shifted(home_tool(), *p) for p in ((0.0, 0.04, 0.0), (0.0, 0.04, 0.05))]
    for T in ends:
        pose = stamped_pose(T, "kuka/base_frame", rospy.Time())
        client.send_goal(MoveGoal(kind=MoveGoal.POSE, pose=pose, straight=True, velocity=0.1))
        assert client.wait_for_result(rospy.Duration(MOVE_S)) and client.get_result().success
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(1.0) == 0
    run = read(tmp_path / "run")
    assert len(run.goals) > 50 and len(run.joints) > 50 and run.manifest["robot"]["model"]["robot"] == "LBR7R800"
    np.testing.assert_allclose(run.goals[-1], run.joints[-1], atol=0.01)
    assert np.all(np.diff(run.goal_times) >= 0.0)

    def replay(answers, expected):
        ended = ros.run("leap_rig", "replay.py", f"{tmp_path}/run", "--robot")
        ended.stdin = io.StringIO(answers)
        assert ended.wait(120.0) == expected, ended.log
        return ended.log

    def motions():
        return sum(mode.data == "moving" for mode in modes)

    # From where the arm is, nothing moves without a yes, nor with other limits than those of the recording.
    before = motions()
    for answers, port in (("", robot.port), ("no\n", 1)):
        rospy.set_param("kuka/running/parameters/port", port)
        assert ("what stands around this arm may differ" in replay(answers, 1)) == (port == 1)
    rospy.set_param("kuka/running/parameters/tcp_speed", 0.1)
    assert "tcp_speed" in replay("yes\n", 1) and motions() == before
    rospy.set_param("kuka/running/parameters/tcp_speed", run.manifest["robot"]["limits"]["tcp_speed"])
    rospy.set_param("kuka/tcp_speed", 0.1)  # which counts for the next controller only

    way = []
    watching = clock.Event()

    def watch():
        while not watching.wait(0.05):
            way.append(robot.tool[:3, 3])

    watcher = clock.Thread(target=watch, daemon=True)
    watcher.start()
    said = replay("yes\nno\n", 1)
    watching.set()
    watcher.join()  # it speaks to the robot over the same connection
    assert "Cancelled" in said  # the second pass, at full pace, was not agreed to
    np.testing.assert_allclose(robot.tool[:3, 3], ends[-1][:3, 3], atol=8e-3)
    for T in (home_tool(), ends[0]):
        assert min(np.linalg.norm(np.array(way) - T[:3, 3], axis=1)) < 0.015


@pytest.mark.parametrize(("typed", "agrees"), [("yes\n", True), ("no\n", False), ("\n", False), ("", False)])
def test_only_yes_agrees_and_the_end_of_the_input_does_not(monkeypatch, typed, agrees):
    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    assert _agrees("?") is agrees
