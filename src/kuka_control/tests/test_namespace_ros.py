"""The names of a controller: as the contract has them with one arm, and all in its namespace where there are two."""

from __future__ import annotations

import signal

import numpy as np
import pytest
import yaml
from controller_rig import CONFIG, MOVE_S, QUICK, RATES, REAL_TIME, Hand, run_robot

from common import clock
from common.poses import pose

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from kuka_control.model.config import RobotAddress
from kuka_msgs.msg import jointPositions
from kuka_msgs.srv import setKukaControl

pytestmark = pytest.mark.ros

ARMS = {"margin": 0.3, "left": {"position": [0.0, 0.5, 0.0]}, "right": {"position": [0.0, -2.0, 0.0]}}


@pytest.fixture
def robot(ros):
    return run_robot(ros, ros.wait_until, "--port", "0", "--control-port", "0")


def set_params(namespace, prefix, port):
    values = yaml.safe_load((CONFIG / "kuka_params_rt.yaml").read_text())
    address = {"ip": "127.0.0.1", "port": port, "tool_mass": 0.0}
    rospy.set_param(f"{namespace}/kuka", {**values, **QUICK[REAL_TIME], **RATES, **address})
    if prefix:
        rospy.set_param(f"{namespace}/tf_prefix", prefix)
        rospy.set_param("/right/kuka", values)
        rospy.set_param("/arms", ARMS)


def frames_of(recordings, node):
    """The tf edges (parent, child) that a node has published."""
    return {
        (transform.header.frame_id, transform.child_frame_id)
        for recording in recordings
        for message in recording
        if message._connection_header["callerid"] == node
        for transform in message.transforms
    }


@pytest.mark.parametrize("namespace, prefix", [("", ""), ("/left", "left")], ids=["one arm", "left of two"])
def test_the_names_of_a_controller(ros, robot, names_on_the_page, namespace, prefix):
    of, node = f"{prefix}/" if prefix else "", f"{namespace}/kuka_real_time_node"
    set_params(namespace, prefix, robot.port)
    modes = ros.record(f"{namespace}/kuka/mode", String)
    edges = ros.record("/tf", TFMessage), ros.record("/tf_static", TFMessage)
    joints = ros.record(f"{namespace}/kuka/joint_positions", jointPositions)
    markers = ros.record(f"{namespace}/kuka/workspace", MarkerArray)
    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    remapped = [f"__ns:={namespace}"] if namespace else []
    ros.run("kuka_control", REAL_TIME, *remapped)

    def mode(name):
        ros.wait_until(lambda: modes and modes[-1].data == name, MOVE_S, name)

    mode("home")
    centre = rospy.get_param(f"{namespace}/kuka/ws_center")
    assert len(rospy.get_param(f"{namespace}/kuka/joints_home")) == 7
    expected = names_on_the_page("kuka_real_time_node", namespace)
    assert len(expected["publishes"]) > 20 and len(expected["offers"]) == 7
    assert ros.names(node) == expected
    # The frame of another arm does not move this one, its own does.
    c = np.sqrt(0.5)
    T = pose([[-c, c, 0.0], [c, c, 0.0], [0.0, 0.0, -1.0]], np.add(centre, (0.0, 0.0, 0.06)))
    set_control = rospy.ServiceProxy(f"{namespace}/kuka/kuka_control", setKukaControl)
    assert set_control(True).success
    other = Hand(T, of="right/" if prefix else "left/")
    clock.sleep(3.0)
    other.hide()
    assert modes[-1].data == "home"
    mine = Hand(T, of=of)
    mode("servo")
    base = f"{of}kuka/base_frame"
    names = {f"{part}_frame/{which}" for part in ("flange", "tool") for which in ("home", "measured")}
    shown = {(base, f"{of}kuka/{name}") for name in (*names, "tool_frame/commanded")}
    shown |= {("world", base)} if prefix else set()
    clock.sleep(2.0)
    assert frames_of(edges, node) == shown
    assert robot.is_at(T)
    assert {message.header.frame_id for message in joints} == {base}
    assert {status.name for message in diagnostics for status in message.status} == {f"{of}kuka_control"}
    assert {marker.header.frame_id for message in markers for marker in message.markers} == {base}
    mine.hide()
    mode("home")
    target = [f"{x:.3f}" for x in np.add(centre, (0.0, 0.0, 0.03))]
    program = ros.run("kuka_control", "move.py", "pose", *target, "135", "0", "180", *remapped)
    assert program.wait(MOVE_S) == 0, program.log


@pytest.mark.parametrize(
    "prefix, arms, options, words",
    [
        ("left", {**ARMS, "right": {"position": [0.0, 0.0, 0.0]}}, (), "left and right are 0.000 m apart, but arms/"),
        ("left", {**ARMS, "margin": 0.1}, (), "arms/margin is 0.1"),
        ("middle", ARMS, (), "tf_prefix is 'middle', but arms/ places only left, right"),
        ("left", ARMS, ("--lift-workspace",), "places another arm beside this one"),
    ],
)
def test_an_arm_that_may_not_move_beside_the_other_exits_before_it_connects(ros, robot, prefix, arms, options, words):
    set_params("/left", prefix, robot.port)
    rospy.set_param("/arms", arms)
    process = ros.run("kuka_control", REAL_TIME, *options, "__ns:=/left")
    assert process.wait(30.0) == 1
    assert words in process.log and "Traceback" not in process.log, process.log
    assert "connected" not in robot.log


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"simulated": True}, "The file of arms:= was measured with simulated devices"),
        ({}, "The file of arms:= does not say whether it was measured with real devices"),
        ({"simulated": False}, ""),
    ],
)
def test_a_real_arm_refuses_places_that_were_measured_in_simulation_and_doubts_unknown_ones(
    ros, robot, monkeypatch, said, words
):
    monkeypatch.setattr(RobotAddress, "on_this_machine", False)
    set_params("/left", "left", robot.port)
    set_right()
    together = {**{key: value for key, value in ARMS.items() if key != "simulated"}, "right": ARMS["left"]}
    rospy.set_param("/arms", {**together, **said})
    process = ros.run("kuka_control", REAL_TIME, "__ns:=/left")
    assert process.wait(30.0) == 1
    assert words in process.log and bool(words) is ("measured with" in process.log), process.log
    assert ("left and right are 0.000 m apart" in process.log) is not said.get("simulated", False)
    assert "connected" not in robot.log


def set_right(**kuka):
    rospy.set_param("/right", {"tf_prefix": "right", "kuka": {**rospy.get_param("/left/kuka"), **kuka}})


def test_the_controllers_of_two_arms_that_run_place_both_alike(ros, robot):
    """Or their walls would stand at different places: what a controller started with counts, as long as it runs."""
    set_params("/left", "left", robot.port)
    left = ros.run("kuka_control", REAL_TIME, "__ns:=/left")
    ros.wait_until(lambda: "The arm is at home" in left.log, MOVE_S, "the left arm at home")
    set_right()
    rospy.set_param("/arms", {**ARMS, "right": {"position": [0.0, -2.5, 0.0]}})
    right = ros.run("kuka_control", REAL_TIME, "__ns:=/right")
    assert right.wait(10.0) == 1
    assert "arm left runs and was started with other values of arms/" in right.log
    left.send_signal(signal.SIGKILL)
    right = ros.run("kuka_control", REAL_TIME, "__ns:=/right")
    ros.wait_until(lambda: "Connecting to the robot" in right.log, 10.0, "the start of the right arm")


def test_the_workspace_that_a_running_controller_keeps_counts_and_not_what_is_set_since(ros, robot):
    set_params("/left", "left", robot.port)
    rospy.set_param("/arms", {**ARMS, "right": {"position": [0.8, 0.3, 0.0]}})
    rospy.set_param("/left/kuka/opening_angle", 10.0)
    left = ros.run("kuka_control", REAL_TIME, "__ns:=/left")
    ros.wait_until(lambda: "Connecting to the robot" in left.log, 10.0, "the start of the left arm")
    rospy.set_param("/left/kuka/opening_angle", 50.0)
    set_right()
    right = ros.run("kuka_control", REAL_TIME, "__ns:=/right")
    ros.wait_until(lambda: "Connecting to the robot" in right.log, 10.0, "the start of the right arm")
    left.send_signal(signal.SIGKILL)
    right.send_signal(signal.SIGKILL)
    right = ros.run("kuka_control", REAL_TIME, "__ns:=/right")
    assert right.wait(10.0) == 1 and "The workspaces of the arms" in right.log
