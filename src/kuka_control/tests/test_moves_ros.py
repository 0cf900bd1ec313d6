"""The action kuka/move of a controller on the simulated arm, by an action client and by the program move.py."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from controller_rig import MOVE_S, REAL_TIME, Hand, Node, home_tool, run_robot, set_params, shifted

from common import clock

pytest.importorskip("rig_msgs.srv")
import actionlib
import rospy
from actionlib import CommState
from geometry_msgs.msg import Vector3Stamped
from std_msgs.msg import String

from common.ros.conversions import stamped_pose
from kuka_msgs.msg import MoveAction, MoveGoal, jointTorquesExternal
from rig_msgs.msg import KukaStatus

pytestmark = pytest.mark.ros


@pytest.fixture
def robot(ros, request):
    server = ("--robot-server", getattr(request, "param", "toolbox"))
    return run_robot(ros, ros.wait_until, "--port", "0", "--control-port", "0", "--tool-weight", *server)


@pytest.fixture
def node(ros, robot, request):
    """A controller whose arm is at home; of changed parameters where a test names them."""
    changes = getattr(request, "param", {})
    set_params(REAL_TIME, ip="127.0.0.1", port=robot.port, velocity_ptp_slow=0.9, **changes)
    node = Node(None, ros.wait_until)
    node.modes = ros.record("kuka/mode", String)
    node.process = ros.run("kuka_control", REAL_TIME)
    node.wait_for_mode("home")
    return node


class Client:
    """Not actionlib's simple client, in which a late status of a goal that was rejected may end the next one."""

    def __init__(self, ros):
        self._ros = ros
        self._client = actionlib.ActionClient("kuka/move", MoveAction)
        assert self._client.wait_for_server(rospy.Duration(5.0))

    def send(self, **goal):
        self.feedback, self.times = [], []
        return self._client.send_goal(MoveGoal(**goal), feedback_cb=lambda _, told: self._note(told))

    def _note(self, told):
        self.feedback.append(told)
        self.times.append(clock.monotonic())

    def result_of(self, handle):
        self._ros.wait_until(lambda: handle.get_comm_state() == CommState.DONE, MOVE_S, "the result")
        return handle.get_result()

    def move(self, **goal):
        return self.result_of(self.send(**goal))


@pytest.fixture
def client(ros, node):
    return Client(ros)


def pose_goal(T, frame="kuka/base_frame", **goal):
    return {"kind": MoveGoal.POSE, "pose": stamped_pose(T, frame, rospy.Time()), **goal}


@pytest.mark.hazard(24)
def test_the_weight_of_the_hand_and_of_a_payload_is_no_contact(ros, node):
    contact = ros.record("kuka/joint_torques_contact", jointTorquesExternal)
    external = ros.record("kuka/joint_torques_external", jointTorquesExternal)
    force = ros.record("kuka/flange_force", Vector3Stamped)
    clock.sleep(2.0)
    assert abs(external[-1].joint_2) > 3.0 and abs(contact[-1].joint_2) < 0.05 and abs(force[-1].vector.z) < 0.05
    assert not node.call("set_payload", "setPayload", 5.5).success
    assert node.call("set_payload", "setPayload", 1.0).success
    clock.sleep(1.0)
    assert force[-1].vector.z < -9.5, "a payload that the simulated arm does not bear"
    assert node.call("set_payload", "setPayload", 0.0).success


@pytest.mark.parametrize("node", [{"flange_force_raw": True}], indirect=True)
def test_a_raw_flange_force_has_the_weight_of_the_hand_whatever_the_load_and_contact_torques_do_not(ros, node):
    contact = ros.record("kuka/joint_torques_contact", jointTorquesExternal)
    force, torque = (ros.record(f"kuka/flange_{name}", Vector3Stamped) for name in ("force", "torque"))

    def check(place):
        clock.sleep(2.0)
        assert force[-1].vector.z == pytest.approx(1.12 * 9.81, abs=0.1), f"{place}: the hand's weight"
        assert abs(torque[-1].vector.y) == pytest.approx(1.12 * 9.81 * 0.022, abs=0.05), f"{place}: its lever"

    check("at home")
    assert abs(contact[-1].joint_2) < 0.05
    assert node.call("set_payload", "setPayload", 1.0).success
    check("with a payload, which takes nothing off")
    assert node.control(True).success
    Hand(home_tool())
    node.wait_for_mode("servo")
    check("in servo mode")


def test_a_line_with_its_feedback_a_cancelled_one_and_home_as_control_goes_off(ros, robot, node, client):
    home, start = home_tool(), robot.joints
    assert node.control(True).success
    T = shifted(home, 0.0, 0.03, 0.08)
    result = client.move(**pose_goal(T, straight=True, velocity=0.1))
    assert result.success, result.message
    assert len(client.times) > 8 and np.all(np.abs(np.diff(client.times[1:]) - 0.1) < 0.01), "once servo mode runs"
    assert np.all(np.diff([told.fraction for told in client.feedback]) >= 0.0) and client.feedback[-1].fraction <= 1.0
    node.wait_for_mode("holding", timeout=0.1)
    np.testing.assert_allclose(robot.tool[:3, 3], T[:3, 3], atol=2e-3)
    np.testing.assert_allclose(result.joints, robot.joints, atol=2e-3)

    line = client.send(**pose_goal(home, straight=True, velocity=0.01))
    node.wait_for_mode("moving", timeout=2.0)
    result = client.move(kind=MoveGoal.NAMED, name="home")
    assert "has not ended" in result.message
    line.cancel()
    begun = clock.monotonic()
    result = client.result_of(line)
    assert not result.success and "cancelled" in result.message and clock.monotonic() - begun < 0.5
    stopped = robot.joints
    assert np.linalg.norm(robot.tool[:3, 3] - home[:3, 3]) > 0.02
    clock.sleep(2.0)
    np.testing.assert_allclose(robot.joints, stopped, atol=1e-3)

    assert node.control(False).success
    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, start, atol=2e-3)


GUIDABLE = {"robot_server": "leap_rig", "tool_mass": 1.12}


@pytest.mark.parametrize(("robot", "node"), [("leap_rig", GUIDABLE)], indirect=True)
def test_hand_guiding_begins_or_is_refused_by_the_reason(ros, robot, node, client):
    status = ros.record("kuka/status", KukaStatus)

    def guide(on=True):
        return node.call("guide", "setKukaControl", on)

    def refused(why):
        answer = guide()
        assert not answer.success and why in answer.message
        assert not any(each.guided for each in status), "no panel shows that a hand may guide the arm"

    refused("Control is off; a hand may guide the arm only while the operator has switched it on.")
    hand = Hand(shifted(home_tool(), 0.0, 0.3, 0.0))  # too far to be taken over
    clock.sleep(1.0)
    assert node.control(True).success
    refused("The desired tool frame comes from a tracked hand or a node; end that before a hand may guide the arm.")
    result = client.move(kind=MoveGoal.GUIDED)
    assert not result.success and "end that before a hand may guide the arm" in result.message
    hand.hide()
    clock.sleep(2.0)
    assert node.call("soft", "setKukaControl", True).success, "a soft arm can be guided"
    assert guide().success
    node.wait_for_mode("moving", timeout=0.1)
    clock.sleep(0.5)
    assert status[-1].guided and status[-1].soft
    answer = guide()
    assert not answer.success and "has not ended" in answer.message
    assert not node.call("pause", "setKukaControl", True).success
    assert guide(False).success
    node.wait_for_mode("holding", timeout=2.0)
    clock.sleep(0.5)
    status.clear()

    way = client.send(kind=MoveGoal.NAMED, name="zero", velocity=0.05)
    node.wait_for_mode("moving", timeout=2.0)
    refused("has not ended")
    assert node.call("pause", "setKukaControl", True).success
    clock.sleep(0.5)
    assert status[-1].paused
    refused("has not ended")
    assert node.control(False).success
    assert not client.result_of(way).success
    node.wait_for_mode("stopped", timeout=0.1)
    refused("A hand may guide the arm at home or where a program moved it, but the mode is stopped.")
    node.control(True)
    node.wait_for_mode("homing", timeout=1.0)
    refused("but the mode is homing. Control was switched off and on again.")
    node.wait_for_mode("home")
    robot.ask("fault", name="refused")
    answer = guide()
    assert not answer.success and "The robot refused the hand guiding" in answer.message
    node.wait_for_mode("stopped", timeout=0.1)


def test_the_program_its_exit_codes_and_an_interrupt(ros, node):
    def program(*arguments, code):
        process = ros.run("kuka_control", "move.py", *arguments)
        assert process.wait(MOVE_S) == code, process.log
        return process.log

    assert node.control(True).success
    assert "The arm is at hand_mounting." in program("hand_mounting", code=0)
    assert "The arm is at home." in program("home", code=0)
    assert "below z_lower_limit" in program("joints", "-45", "115", "0", "0", "0", "0", "0", code=1)
    x, y, z = shifted(home_tool(), 0.0, 0.0, 0.1)[:3, 3]
    line = ("pose", f"{x}", f"{y}", f"{z}", "135", "0", "180", "--straight", "--velocity", "0.01")
    process = ros.run("kuka_control", "move.py", *line)
    node.wait_for_mode("moving")
    process.send_signal(signal.SIGINT)
    assert process.wait(1.0) == 130 and "cancelled" in process.log
    node.process.send_signal(signal.SIGKILL)
    begun = clock.monotonic()
    assert "Nobody offers kuka/move" in program("home", code=1) and clock.monotonic() - begun < 5.5
