"""The action kuka/move of a controller on the simulated arm, by an action client and by the program move.py."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest
from test_controllers_ros import MOVE_S, Node, home_tool, run_robot, set_params, shifted, tool_of

pytestmark = pytest.mark.ros


@pytest.fixture
def robot(ros, wait_until):
    return run_robot(ros, wait_until, "--port", "0", "--control-port", "0", "--tool-weight")


def test_programs_move_the_arm(ros, robot, wait_until):
    import actionlib
    import rospy
    from geometry_msgs.msg import Vector3Stamped
    from std_msgs.msg import String

    from common.ros.conversions import stamped_pose
    from kuka_msgs.msg import MoveAction, MoveGoal, jointTorquesExternal

    set_params("real_time_controller.py", ip="127.0.0.1", port=robot.port, velocity_ptp_slow=0.9)
    node = Node(None, wait_until)
    node.modes = ros.record("kuka/mode", String)
    contact = ros.record("kuka/joint_torques_contact", jointTorquesExternal)
    external = ros.record("kuka/joint_torques_external", jointTorquesExternal)
    force = ros.record("kuka/flange_force", Vector3Stamped)
    node.process = ros.run("kuka_control", "real_time_controller.py")
    node.wait_for_mode("home")
    # Not the simple client, in which a late status of a goal that was rejected may end the next one.
    client = actionlib.ActionClient("kuka/move", MoveAction)
    assert client.wait_for_server(rospy.Duration(80.0))

    def result_of(handle):
        wait_until(lambda: handle.get_comm_state() == actionlib.CommState.DONE, MOVE_S, "the result")
        return handle.get_result()

    def move(**goal):
        feedback_messages = []
        handle = client.send_goal(MoveGoal(**goal), feedback_cb=lambda _, feedback: feedback_messages.append(feedback))
        return result_of(handle), feedback_messages

    def pose_goal(T, **goal):
        message = stamped_pose(T, goal.pop("frame", "kuka/base_frame"), rospy.Time())
        return {"kind": MoveGoal.POSE, "pose": message, **goal}

    # Nothing moves while control is off, or for an invalid goal.
    home = home_tool()
    start = robot.joints
    for goal, words in (
        ({"kind": MoveGoal.NAMED, "name": "hand_mounting"}, "Control is off"),
        ({"kind": MoveGoal.NAMED, "name": "nowhere"}, "There is no position 'nowhere'"),
        ({"kind": 7}, "must be JOINTS, POSE or NAMED"),
        (pose_goal(home, frame="camera_link"), "its frame is 'camera_link'"),
        (pose_goal(shifted(home, np.nan, 0.0, 0.0)), "not finite"),
    ):
        result, _ = move(**goal)
        assert not result.success and words in result.message
    loose = pose_goal(home)
    loose["pose"].pose.orientation.x += 0.01
    result, _ = move(**loose)
    assert not result.success and "instead of 1" in result.message
    np.testing.assert_allclose(robot.joints, start, atol=1e-9)

    # The robot's external torques contain the weight of the hand; the contact torques do not.
    wait_until(lambda: contact and external and force, 20.0, "the torques")
    assert abs(external[-1].joint_2) > 3.0 and abs(contact[-1].joint_2) < 0.05
    wait_until(lambda: abs(force[-1].vector.z) < 0.05, 20.0, "a force without the weight")
    assert not node.call("set_payload", "setPayload", 5.5).success
    assert node.call("set_payload", "setPayload", 1.0).success
    wait_until(lambda: force[-1].vector.z < -9.5, 20.0, "a payload that the simulated arm does not bear")
    assert node.call("set_payload", "setPayload", 0.0).success

    # A line, with its feedback.
    assert node.control(True).success
    T = shifted(home, 0.0, 0.03, 0.08)
    result, feedback_messages = move(**pose_goal(T, straight=True, velocity=0.1))
    assert result.success, result.message
    assert feedback_messages and 0.0 < feedback_messages[-1].fraction <= 1.0
    node.wait_for_mode("holding")
    np.testing.assert_allclose(tool_of(robot)[:3, 3], T[:3, 3], atol=2e-3)
    np.testing.assert_allclose(result.joints, robot.joints, atol=2e-3)

    # A line that is cancelled stops on its way; the arm stays.
    line = client.send_goal(MoveGoal(**pose_goal(home, straight=True, velocity=0.01)))
    wait_until(lambda: node.modes[-1].data == "moving", 20.0, "a line")
    result, _ = move(kind=MoveGoal.NAMED, name="home")
    assert "has not ended" in result.message
    line.cancel()
    result = result_of(line)
    assert not result.success and "cancelled" in result.message
    stopped = robot.joints
    assert np.linalg.norm(tool_of(robot)[:3, 3] - home[:3, 3]) > 0.02
    time.sleep(0.5)
    np.testing.assert_allclose(robot.joints, stopped, atol=1e-3)

    # The program: its exit codes, and Ctrl-C.
    def program(*arguments, code):
        process = ros.run("kuka_control", "move.py", *arguments)
        wait_until(lambda: process.poll() is not None, MOVE_S, "the end of move.py")
        text = process.log_path.read_text()
        assert process.returncode == code, text
        return text

    assert "The arm is at home." in program("home", code=0)
    assert "below z_lower_limit" in program("joints", "-45", "115", "0", "0", "0", "0", "0", code=1)
    x, y, z = shifted(home, 0.0, 0.0, 0.1)[:3, 3]
    line = ("pose", f"{x}", f"{y}", f"{z}", "135", "0", "180", "--straight", "--velocity", "0.01")
    process = ros.run("kuka_control", "move.py", *line)
    wait_until(lambda: node.modes[-1].data == "moving", 20.0, "the line of move.py")
    process.send_signal(signal.SIGINT)
    wait_until(lambda: process.poll() is not None, 20.0, "the end of move.py")
    assert process.returncode == 130 and "cancelled" in process.log_path.read_text()

    # Control off brings the arm home.
    assert node.control(False).success
    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, start, atol=2e-3)
