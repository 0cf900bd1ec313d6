"""A recorded motion on the simulated arm: agreed to, slowly first, through kuka/move."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from leap_rig.recording import read

pytestmark = pytest.mark.ros
sys.path.append(str(Path(__file__).parents[2] / "kuka_control" / "tests"))


def test_the_arm_repeats_its_motion_only_when_the_operator_agrees(ros, wait_until, tmp_path, processes, without_search):
    import rospy
    from std_msgs.msg import String
    from test_controllers_ros import MOVE_S, Node, home_tool, run_robot, set_params, shifted, tool_of

    from common.ros.action_client import ActionClient
    from common.ros.conversions import stamped_pose
    from kuka_msgs.msg import MoveAction, MoveGoal

    robot = run_robot(ros, wait_until, "--port", "0", "--control-port", "0", "--tool-weight")
    set_params("real_time_controller.py", ip="127.0.0.1", port=robot.port, velocity_ptp_slow=0.9, velocity_ptp_fast=0.9)
    node = Node(None, wait_until)
    modes = node.modes = ros.record("kuka/mode", String)
    node.process = ros.run("kuka_control", "real_time_controller.py")
    recorder = ros.run("leap_rig", "record.py", f"{tmp_path}/run")
    node.wait_for_mode("home")
    wait_until(lambda: "frames" in recorder.log_path.read_text(), 20.0, "the recorder")
    client = ActionClient("kuka/move", MoveAction)
    assert client.wait_for_server(rospy.Duration(20.0))
    assert node.control(True).success
    ends = [shifted(home_tool(), *p) for p in ((0.0, 0.04, 0.0), (0.0, 0.04, 0.05))]
    for T in ends:
        pose = stamped_pose(T, "kuka/base_frame", rospy.Time())
        client.send_goal(MoveGoal(kind=MoveGoal.POSE, pose=pose, straight=True, velocity=0.1))
        assert client.wait_for_result(rospy.Duration(MOVE_S)) and client.get_result().success
    assert processes.end(recorder) == 0
    run = read(tmp_path / "run")
    assert len(run.goals) > 50 and len(run.joints) > 50 and run.manifest["robot"]["model"]["robot"] == "LBR7R800"
    np.testing.assert_allclose(run.goals[-1], run.joints[-1], atol=0.01)
    assert np.all(np.diff(run.goal_times) >= 0.0)

    def replay(answers, *options):
        command = without_search(("rosrun", "leap_rig", "replay.py", f"{tmp_path}/run", "--robot", *options))
        return subprocess.run(command, input=answers, text=True, capture_output=True, timeout=120, check=False)

    def goals():
        return sum(mode.data == "moving" for mode in modes)

    # From where the arm is, nothing moves without a yes, nor with other limits than those of the recording.
    before = goals()
    for answers, port in (("", robot.port), ("no\n", 1)):
        rospy.set_param("kuka/port", port)
        ended = replay(answers)
        assert ended.returncode == 1, ended.stderr
        assert ("what stands around this arm may differ" in ended.stdout) == (port == 1)
    rospy.set_param("kuka/tcp_speed", 0.1)
    assert "tcp_speed" in replay("yes\n").stderr and goals() == before
    rospy.set_param("kuka/tcp_speed", run.manifest["robot"]["limits"]["tcp_speed"])

    corner = []
    watcher = rospy.Timer(rospy.Duration(0.05), lambda _: corner.append(tool_of(robot)[:3, 3]))
    ended = replay("yes\nno\n")
    watcher.shutdown()
    watcher.join()  # it speaks to the robot over the same connection
    assert "Cancelled" in ended.stdout, ended.stdout + ended.stderr  # the second pass, at full pace, was not agreed to
    np.testing.assert_allclose(tool_of(robot)[:3, 3], ends[-1][:3, 3], atol=8e-3)
    for T in (home_tool(), ends[0]):
        assert min(np.linalg.norm(np.array(corner) - T[:3, 3], axis=1)) < 0.015


@pytest.mark.parametrize(("typed", "agrees"), [("yes\n", True), ("no\n", False), ("\n", False), ("", False)])
def test_only_yes_agrees_and_the_end_of_the_input_does_not(monkeypatch, typed, agrees):
    from leap_rig.recording.ros.replay_program import _agrees

    monkeypatch.setattr(sys, "stdin", io.StringIO(typed))
    assert _agrees("?") is agrees
