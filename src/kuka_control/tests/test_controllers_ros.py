"""The two controllers as nodes, on the simulated robot: parameters, services, topics, tf, and how they end."""

from __future__ import annotations

import re
import signal
import types

import numpy as np
import pytest
from controller_rig import (
    CONFIG,
    MOVE_S,
    PTP,
    REAL_TIME,
    SLOW,
    Hand,
    Node,
    home_tool,
    quick_params,
    run_robot,
    set_params,
    shifted,
)
from loop_world import rig

from common import clock
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx
from kuka_control.model.config import RealTimeConfig

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import JointState, TimeReference
from std_msgs.msg import Bool, String
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from common.ros.conversions import pose_from_message, pose_from_transform, stamped_pose
from kuka_control.model.config import RobotAddress
from kuka_control.ros import controller_node
from kuka_msgs.msg import jointPositions, jointTorquesExternal, jointTorquesMeasured
from rig_msgs.msg import KukaStatus
from rig_msgs.srv import CheckToolPose

pytestmark = pytest.mark.ros

EXAMPLE = str(CONFIG / "dh_parameters_example.yaml")
LINK_LOST = "The link to the robot is lost for the moment"


@pytest.fixture
def robot(ros, request):
    """The simulated robot; a test may add arguments by indirect parameters."""
    return run_robot(ros, ros.wait_until, "--port", "0", "--control-port", "0", *getattr(request, "param", ()))


@pytest.fixture
def run(ros):
    """Starts a controller with the parameters that are set."""

    def run_controller(executable=REAL_TIME, *options):
        node = Node(None, ros.wait_until)
        node.modes = ros.record("kuka/mode", String)
        node.process = ros.run("kuka_control", executable, *options)
        return node

    return run_controller


@pytest.fixture
def start(robot, run):
    """Starts a controller on the simulated robot with the parameters of its file and `changes`."""

    def start_controller(executable=REAL_TIME, **changes):
        quick_params(executable, robot.port, **changes)
        return run(executable)

    return start_controller


def leaves_and_comes_back(hand, node):
    """The hand leaves the box and comes back, as a stream counts only if it begins after control was switched on."""
    hand.hide()
    clock.sleep(0.5)
    hand.show()
    node.wait_for_mode("servo")


def frame(name, ros):
    """Returns the pose of a frame in the base, shape (4, 4) [m]."""
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    ros.wait_until(lambda: buffer.can_transform("kuka/base_frame", name, rospy.Time(0)), 20.0, f"tf of {name}")
    listener.unregister()
    return pose_from_transform(buffer.lookup_transform("kuka/base_frame", name, rospy.Time(0)).transform)


def check_tool_poses(node, robot):
    """Whether the tool can be brought to a pose; the scaling factor is 0.5 and the arm does not move."""
    assert node.call("scaling_factor", "setScalingFactor", 0.5).success
    before = robot.joints
    check = rospy.ServiceProxy("kuka/check_tool_pose", CheckToolPose)

    def ask(T, frame="kuka/base_frame"):
        return check(stamped_pose(T, frame, rospy.Time()))

    good = ask(shifted(home_tool(), 0.03, 0.0, 0.05))
    assert good.success and good.message == "The arm can bring the tool there."
    np.testing.assert_allclose(pose_from_message(good.desired), shifted(home_tool(), 0.06, 0.0, 0.1), atol=1e-4)
    for bad, words in (
        (ask(shifted(home_tool(), 0.0, 0.0, -0.3)), "lower z limit"),
        (ask(home_tool(), "camera_link"), "its frame is 'camera_link' instead of kuka/base_frame"),
        (ask(shifted(home_tool(), np.nan, 0.0, 0.0)), "not finite"),
    ):
        assert not bad.success and words in bad.message
    no_rotation = stamped_pose(home_tool(), "kuka/base_frame", rospy.Time())
    no_rotation.pose.orientation.x = no_rotation.pose.orientation.y = 0.0
    no_rotation.pose.orientation.z = no_rotation.pose.orientation.w = 0.0
    assert "norm 0 instead of 1" in check(no_rotation).message
    np.testing.assert_allclose(robot.joints, before, atol=1e-9)


def test_the_life_of_the_real_time_controller(ros, robot, run):
    topics = {
        "joint_states": JointState,
        "kuka/joint_positions": jointPositions,
        "kuka/joint_torques_external": jointTorquesExternal,
        "kuka/joint_torques_measured": jointTorquesMeasured,
        "kuka/flange_force": Vector3Stamped,
        "kuka/flange_torque": Vector3Stamped,
        "kuka/moving_rt": Bool,
        "kuka/moving_ptp": Bool,
        "kuka/gripper_control": Bool,
        "kuka/status": KukaStatus,
        "kuka/workspace": MarkerArray,
        "rig/stage_times": TimeReference,
        "/tf": TFMessage,
    }
    heard = {name: ros.record(name, kind) for name, kind in topics.items()}
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    set_params(REAL_TIME, ip="127.0.0.1", port=robot.port, tool_mass=0.0)
    node = run()

    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, rospy.get_param("kuka/joints_home"), atol=1e-3)
    np.testing.assert_allclose(rospy.get_param("kuka/ws_center"), [0.42214, -0.42214, 0.4], atol=1e-4)
    assert heard["kuka/workspace"][0].markers
    heard["kuka/flange_torque"].wait()
    measured, at_home = (frame(f"kuka/flange_frame/{name}", ros) for name in ("measured", "home"))
    np.testing.assert_allclose(measured, at_home, atol=1e-3)
    np.testing.assert_allclose(frame("kuka/tool_frame/home", ros), home_tool(), atol=1e-6)

    assert node.call("gripper_control", "setGripperControl", True).success
    ros.wait_until(lambda: heard["kuka/gripper_control"][-1].data, 0.1, "the gripper flag")
    assert not node.call("scaling_factor", "setScalingFactor", 1.6).success
    assert not node.call("scaling_factor", "setScalingFactor", float("nan")).success
    assert node.call("scaling_factor", "setScalingFactor", 0.5).message == "The scaling factor is 0.5."
    assert node.control(True).success

    T_home = home_tool()
    hand = Hand(shifted(T_home, 0.1, 0.0, 0.06), parent_chain=True)
    node.wait_for_mode("servo")
    ros.wait_until(lambda: robot.is_at(shifted(T_home, 0.05, 0.0, 0.03)), 5.0, "the tool at half the way of the hand")
    ros.wait_until(lambda: heard["kuka/moving_rt"][-1].data, 0.1, "moving_rt")
    for factor in (1.0, 0.5):
        assert node.call("scaling_factor", "setScalingFactor", factor).success
        clock.sleep(1.0)
        status = rospy.wait_for_message("kuka/status", KukaStatus, 1.0)
        offset = [status.scaling_offset.x, status.scaling_offset.y, status.scaling_offset.z]
        np.testing.assert_allclose(offset, (factor - 0.5) / 0.5 * np.array([-0.05, 0.0, -0.03]), atol=1e-6)
        assert status.mode == "servo" and status.scaling_factor == factor
        assert robot.is_at(shifted(T_home, 0.05, 0.0, 0.03)), "a new factor moves nothing"

    for messages in heard.values():
        messages.clear()
    for z in np.linspace(0.06, 0.0, 100):
        hand.T = shifted(T_home, 0.1, 0.0, z)
        clock.sleep(0.01)
    counts = {name: len(messages) for name, messages in heard.items()}
    ros.wait_until(lambda: robot.is_at(shifted(T_home, 0.05, 0.0, 0.0)), 1.0, "the tool where the hand is")
    assert [m.data for m in node.modes].count("servo") == 1
    assert counts["joint_states"] == pytest.approx(100, abs=2)
    assert 250 <= counts["kuka/joint_positions"] <= 350, "with each goal: in each period, and for each frame"
    for name in ("joint_torques_external", "joint_torques_measured", "flange_force", "flange_torque"):
        assert 25 <= counts[f"kuka/{name}"] <= 35, f"{name} comes with one goal in ten"
    frames = [t.child_frame_id for m in heard["/tf"] for t in m.transforms]
    assert frames.count("kuka/flange_frame/measured") > 0.9 * len(heard["joint_states"]), "with the joints in motion"
    assert counts["rig/stage_times"] > 10 and {m.source for m in heard["rig/stage_times"]} == {"kuka_control"}
    assert heard["joint_states"][-1].name == [f"kuka/joint_{i}" for i in range(1, 8)]
    np.testing.assert_allclose(heard["joint_states"][-1].position, robot.joints, atol=1e-3)
    commanded = buffer.lookup_transform("kuka/base_frame", "kuka/tool_frame/commanded", rospy.Time(0)).transform
    assert abs(commanded.translation.x - (T_home[0, 3] + 0.05)) < 1e-6
    status = heard["kuka/status"][-1]
    assert (status.control_on, status.mode, status.scaling_factor) == (True, "servo", pytest.approx(0.5))
    assert status.limited_by == []
    for z in np.linspace(0.0, -0.7, 100):
        hand.T = shifted(T_home, 0.1, 0.0, z)
        clock.sleep(0.01)
    assert "lower z limit" in heard["kuka/status"][-1].limited_by

    hand.hide()
    hidden = clock.monotonic()
    ros.wait_until(
        lambda: "No new desired tool frame came for 0.2 s" in node.log, 1.0, "the arm to leave the hand", poll=0.001
    )
    assert 0.2 - 0.01 <= clock.monotonic() - hidden <= 0.2 + 0.01, "after time_out"
    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, rospy.get_param("kuka/joints_home"), atol=1e-3)

    answer = node.call("exit_app", "exitApp")
    assert answer.success and "zero" in answer.message
    assert node.wait_for_end() == 0
    np.testing.assert_allclose(robot.joints, np.zeros(7), atol=1e-3)
    assert node.moved_through() == ["homing", "home", "pick_up", "servo", "returning", "home", "zero", "stopped"]


@pytest.mark.hazard(2)
def test_a_safety_stop_is_latched_and_nothing_lurches_when_it_is_released_and_the_emergency_exit_ends_at_once(
    ros, robot, start
):
    node = start()
    node.wait_for_mode("home")
    assert node.control(True).success
    T_home = home_tool()
    hand = Hand(T_home)
    node.wait_for_mode("servo")
    robot.ask("set_external_torque", value=[0, 30, 0, 0, 0, 0, 0])
    clock.sleep(0.01)
    assert robot.ask("state")["safety_stop"]
    robot.ask("set_external_torque", value=[0] * 7)
    for x in np.linspace(0.0, 0.06, 60):
        hand.T = shifted(T_home, x, 0.0, 0.0)
        clock.sleep(0.01)
    node.wait_for_mode("stopped")
    stopped_at = robot.joints
    robot.ask("release")
    clock.sleep(1.0)
    np.testing.assert_allclose(robot.joints, stopped_at, atol=2e-3)
    answer = node.control(True)
    assert not answer.success and "off and on again" in answer.message
    assert node.control(False).success
    node.engage()
    leaves_and_comes_back(hand, node)
    ros.wait_until(lambda: robot.is_at(hand.T), 5.0, "the tool where the hand is")
    assert robot.ask("state")["stops"] == 1
    assert node.call("exit_app_emergency", "exitAppEmergency").success
    assert node.wait_for_end(0.1) == 2
    assert "connection to the robot is closed" not in node.log, "it leaves the connection alone"


def test_a_motion_that_something_pushes_on_ends_there_and_both_services_say_what_follows(ros, robot, start):
    node = start(**SLOW)
    node.wait_for_mode("homing")
    clock.sleep(1.0)
    robot.ask("set_external_torque", value=[20, 0, 0, 0, 0, 0, 0])
    node.wait_for_mode("stopped")
    assert "joint 1 bears 20.0 Nm from outside" in node.log
    there = robot.joints
    clock.sleep(3.0)
    np.testing.assert_array_equal(robot.joints, there)
    assert "it touched something on its way" in node.call("exit_app", "exitApp").message
    assert node.wait_for_end() == 1
    np.testing.assert_array_equal(robot.joints, there)


@pytest.mark.parametrize("robot", [("--toolbox-version", version) for version in ("1.7", "2019-03")], indirect=True)
def test_with_a_server_before_may_2019_pose_and_force_are_reckoned(ros, robot, start):
    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    node = start()
    node.wait_for_mode("home")
    for what in ("pose", "force"):
        assert node.log.count(f"does not tell the {what}, as those before May 2019") == 1
    assert node.control(True).success
    T = shifted(home_tool(), 0.0, 0.03, 0.03)
    Hand(T)
    node.wait_for_mode("servo")
    ros.wait_until(lambda: robot.is_at(T), MOVE_S, "the tool where the hand is")
    clock.sleep(1.0)
    np.testing.assert_allclose(frame("kuka/flange_frame/measured", ros), robot.ask("state")["flange"], atol=1e-3)
    np.testing.assert_allclose(frame("kuka/tool_frame/measured", ros), T, atol=1e-3)
    forces = ros.record("kuka/flange_force", Vector3Stamped)
    robot.ask("set_tcp_force", value=[2.0, -3.0, 8.0])
    clock.sleep(1.0)
    np.testing.assert_allclose([getattr(forces[-1].vector, x) for x in "xyz"], [2.0, -3.0, 8.0], atol=0.5)
    reported = [{v.key: v.value for v in status.values} for m in diagnostics for status in m.status]
    assert reported[-1]["estimated_in_servo"] == "moment, pose, force"
    assert reported[-1]["missed_answers"] == "0" and LINK_LOST not in node.log
    assert node.modes[-1].data == "servo"


def test_an_interrupt_while_the_arm_follows_a_moving_hand_brakes_it_by_goals(robot, start):
    node = start()
    node.wait_for_mode("home")
    assert node.control(True).success
    T_home = home_tool()
    hand = Hand(T_home)
    node.wait_for_mode("servo")
    for y in np.linspace(0.0, 0.1, 50):  # 0.2 m/s
        hand.T = shifted(T_home, 0.0, y, 0.0)
        clock.sleep(0.01)
    before = robot.ask("state")
    node.process.send_signal(signal.SIGINT)
    assert node.wait_for_end(2.0) == 0
    after = robot.ask("state")
    assert before["tcp_speed"] > 0.05 and after["goals"] - before["goals"] > 5
    assert after["tcp_speed"] < 1e-3 and after["stops"] == 0, "it stands still before the controller leaves"


def test_the_emergency_exit_works_while_the_robot_hangs(robot, start):
    node = start(**SLOW)
    node.wait_for_mode("homing")
    robot.process.send_signal(signal.SIGSTOP)
    assert node.call("exit_app_emergency", "exitAppEmergency").success
    assert node.wait_for_end(0.1) == 2


def lose(ros, robot, states):
    """Ends the robot's process, and waits until the controller says on kuka/status that it is gone."""
    robot.process.send_signal(signal.SIGKILL)
    ros.wait_until(lambda: states[-1].mode == "stopped" and "out of reach" in states[-1].reason, 2.0, "the status")


def test_a_lost_robot_is_waited_for_and_moves_only_after_control_was_switched_on(ros, robot, start):
    node = start()
    node.wait_for_mode("home")
    node.control(True)
    hand = Hand(home_tool())
    node.wait_for_mode("servo")
    states = ros.record("kuka/status", KukaStatus).wait()
    lose(ros, robot, states)
    assert not states[-1].control_on and "smartPad" in states[-1].reason
    refused = node.control(True)
    assert not refused.success and refused.message == "Control stays off: the robot is out of reach."
    begun = clock.monotonic()
    ros.wait_until(lambda: "Try 3 failed: no toolbox server" in states[-1].reason, 10.0, "three tries")
    assert clock.monotonic() - begun == pytest.approx(0.5 + 1.0 + 2.0, abs=0.3), "the pauses double"
    assert len(re.findall("Try .* failed", node.log)) == 1

    back = run_robot(ros, ros.wait_until, "--port", str(robot.port), "--control-port", "0")
    ros.wait_until(lambda: "connected again" in states[-1].reason, 8.0, "the connection")
    node.modes.clear()
    states.clear()
    clock.sleep(5.0)
    assert {(state.mode, state.control_on) for state in states} == {("stopped", False)} and not node.modes
    assert not back.joints.any() and back.ask("state")["connected"]

    assert "goes home first" in node.engage().message
    leaves_and_comes_back(hand, node)
    ros.wait_until(lambda: back.is_at(home_tool()), 5.0, "the tool where the hand is")
    assert node.moved_through()[0] == "homing"

    lose(ros, back, states)
    answer = node.call("exit_app", "exitApp")
    assert answer.success and "leaves the arm as it is: the robot is out of reach" in answer.message
    assert node.wait_for_end(2.0) == 0
    assert "Traceback" not in node.log


def test_a_robot_that_is_lost_on_the_way_to_the_end_ends_the_controller(robot, start):
    node = start(**SLOW)
    node.wait_for_mode("home")
    assert node.call("exit_app", "exitApp").success
    node.wait_for_mode("zero")
    robot.process.send_signal(signal.SIGKILL)
    assert node.wait_for_end(2.0) == 1
    assert "The robot is out of reach" in node.log and "not at its zero position" in node.log
    assert "Traceback" not in node.log


def test_the_ptp_controller(ros, robot, start):
    node = start(PTP)
    node.wait_for_mode("home")
    check_tool_poses(node, robot)
    assert node.call("scaling_factor", "setScalingFactor", 1.0).success
    assert node.control(True).success
    T = shifted(home_tool(), 0.05, 0.0, 0.05)
    hand = Hand(T)
    ros.wait_until(lambda: robot.is_at(T), MOVE_S, "the tool where the hand is")
    assert "pick_up" in node.moved_through()
    hand.hide()
    node.wait_for_mode("home")
    assert node.call("exit_app", "exitApp").success
    assert node.wait_for_end() == 0
    np.testing.assert_allclose(robot.joints, np.zeros(7), atol=1e-3)


SEVERAL = {"opening_angle": 190, "velocity_ptp_fast": "fast", "unknown": 1, "center_line": [1, 0, 0.5]}


@pytest.mark.hazard(13)
@pytest.mark.parametrize(
    "executable, changes, words",
    [
        (REAL_TIME, SEVERAL, ["kuka/opening_angle", "kuka/velocity_ptp_fast", "kuka/unknown", "horizontal"]),
        (PTP, {"dh_parameters": "/no/such/arm.yaml"}, ["/no/such/arm.yaml"]),
        (REAL_TIME, {"dh_parameters": EXAMPLE, "robot": "LBR14R820"}, ["LBR7R800", "LBR14R820"]),
    ],
)
def test_bad_parameters_are_refused_before_anything_is_connected(robot, start, executable, changes, words):
    node = start(executable, **changes)
    assert node.wait_for_end(20.0) == 1
    assert all(word in node.log for word in words), node.log
    assert "Traceback" not in node.log and "connected" not in robot.log


@pytest.mark.parametrize("executable", [REAL_TIME, PTP])
def test_the_workspace_of_a_real_robot_is_not_lifted(run, executable):
    set_params(executable, ip="192.0.2.1")
    node = run(executable, "--lift-workspace")
    assert node.wait_for_end(20.0) == 1
    assert "--lift-workspace is refused: kuka/ip is 192.0.2.1" in node.log and "Connecting" not in node.log


def test_where_the_workspace_is_lifted_the_tool_leaves_it_and_everybody_is_warned(ros, robot, run):
    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    quick_params(REAL_TIME, robot.port)
    node = run(REAL_TIME, "--lift-workspace")
    node.wait_for_mode("home")
    assert "The workspace is lifted" in node.log
    assert node.control(True).success
    below = shifted(home_tool(), 0.0, 0.0, -0.24)
    Hand(below)
    ros.wait_until(lambda: robot.is_at(below), MOVE_S, "the tool below z_lower_limit")
    status = next(s for m in reversed(diagnostics) for s in m.status if s.name == "kuka_control")
    values = {v.key: v.value for v in status.values}
    assert status.level == 1 and "The workspace is lifted" in status.message and values["workspace"] == "lifted"


@pytest.mark.parametrize("simulated", [True, False])
def test_without_a_robot_it_tries_for_20_s_says_so_and_ends(run, monkeypatch, simulated):
    """It names the way without hardware, unless that was taken: an address of this machine is a simulated arm's."""
    monkeypatch.setattr(RobotAddress, "on_this_machine", simulated)
    set_params(REAL_TIME, ip="127.0.0.1", port=1)
    begun = clock.monotonic()
    node = run()
    assert node.wait_for_end(60.0) == 1
    assert 20.0 < clock.monotonic() - begun < 22.0
    assert "Trying for" in node.log and "There is no connection to the robot" in node.log
    assert ("sim:=true" in node.log) is not simulated
    assert "Traceback" not in node.log


def test_it_waits_15_s_for_the_rest_of_its_parameters_and_refuses_an_incomplete_set_in_one_sentence(run):
    """As after leap_kuka_debug.launch, which uploads two keys of another set."""
    rospy.set_param("kuka", {"center_line": [1, 0, 0], "ws_center": [0.5, 0, 0.5]})
    begun = clock.monotonic()
    node = run(PTP)
    assert node.wait_for_end(20.0) == 1
    assert clock.monotonic() - begun == pytest.approx(15.0, abs=0.5)
    assert re.search("Waiting for parameters under /kuka/: .*robot", node.log)
    refused = re.findall(r"kuka/ has only the parameters center_line, ws_center; .*robot.*", node.log)
    assert refused and len(set(refused)) == 1
    assert "is missing; it must be" not in node.log and "Traceback" not in node.log


def test_it_waits_for_parameters_and_says_so_and_takes_what_comes_late(ros, robot, run):
    node = run(PTP)
    ros.wait_until(lambda: "Waiting for the parameter /kuka" in node.log, 30.0, "the sentence")
    clock.sleep(100.0)
    assert node.process.poll() is None
    rospy.set_param("kuka", {"center_line": [1, 0, 0], "ws_center": [0.5, 0, 0.5]})
    ros.wait_until(lambda: re.search("Waiting for parameters under /kuka/: .*robot", node.log), 10.0, "the sentence")
    quick_params(PTP, robot.port)
    node.wait_for_mode("home")


def test_a_tool_that_is_a_whole_pose(ros, robot, start):
    T_flange_tool = pose(rotation_from_zyx(0.4, 0.3, -0.2), (0.02, -0.03, 0.1))
    node = start(use_tool_transform=True, tool_transform=T_flange_tool.ravel().tolist())
    node.wait_for_mode("home")
    T_home = home_tool()
    for name, expected in (
        ("kuka/tool_frame/home", T_home),
        ("kuka/flange_frame/home", T_home @ inverse(T_flange_tool)),
        ("kuka/flange_frame/measured", T_home @ inverse(T_flange_tool)),
        ("kuka/tool_frame/measured", T_home),
    ):
        np.testing.assert_allclose(frame(name, ros), expected, atol=2e-3, err_msg=name)
    assert node.control(True).success
    T = shifted(T_home, 0.03, 0.0, 0.05)
    Hand(T)
    node.wait_for_mode("servo")
    clock.sleep(2.0)
    np.testing.assert_allclose(np.array(robot.ask("state")["flange"]) @ T_flange_tool, T, atol=3e-3)


def test_a_calibrated_arm_has_its_home_and_its_measured_flange_by_its_own_parameters(ros, robot):
    """The simulated arm is as in the data sheet; its joints are those that the controller chose for another."""
    modes = ros.record("kuka/mode", String)
    own = {"port": robot.port, "dh_parameters": EXAMPLE, "gui": "false"}
    ros.launch("kuka_control", "real_time_controller.launch", ip="127.0.0.1", **own)
    ros.wait_until(lambda: modes and modes[-1].data == "home", MOVE_S, "the arm at home")
    assert rospy.get_param("kuka/dh_parameters") == EXAMPLE and rospy.get_param("kuka/tool_length") == 0.106
    home = frame("kuka/flange_frame/home", ros)
    np.testing.assert_allclose(home[:3, 3] - [0.0, 0.0, 0.106], rospy.get_param("kuka/ws_center"), atol=1e-6)
    np.testing.assert_allclose(frame("kuka/flange_frame/measured", ros)[:3, 3], home[:3, 3], atol=1e-4)
    assert 5e-4 < np.linalg.norm(np.array(robot.ask("state")["flange"])[:3, 3] - home[:3, 3]) < 5e-3


def test_the_centre_of_the_workspace_is_uploaded_last_as_leap_kuka_expects(ros, monkeypatch):
    """What came between its two readings of the parameters was an unknown key, and ended it."""
    uploaded = []
    nothing = types.SimpleNamespace(spin=lambda _: None, close=lambda: None)
    with monkeypatch.context() as patch:
        for name in ("RobotLink", "_Node"):
            patch.setattr(controller_node, name, lambda *_: nothing)
        patch.setattr(controller_node, "wait_for_config", lambda *_, **__: rig(RealTimeConfig)[0])
        patch.setattr(controller_node.rospy, "set_param", lambda key, _: uploaded.append(key))
        controller_node._run(RealTimeConfig, lambda *_: None, types.SimpleNamespace(lift_workspace=False))
    assert uploaded == ["kuka/running", "kuka/joints_home", "kuka/rotation_home", "kuka/ws_center"]


@pytest.fixture
def announced(ros):
    """Announces a node of simulated devices on this ROS master, as itself."""
    publisher = rospy.Publisher("/simulated_devices", String, queue_size=1, latch=True)
    yield lambda: publisher.publish("/operator")
    publisher.unregister()


BESIDE = "The node /operator belongs to simulated devices, and on the same ROS master they could move the real arm"


@pytest.mark.parametrize("executable", [REAL_TIME, PTP])
def test_a_real_arm_is_not_connected_beside_simulated_devices(robot, run, announced, monkeypatch, executable):
    announced()
    quick_params(executable, robot.port)
    monkeypatch.setattr(RobotAddress, "on_this_machine", False)
    node = run(executable)
    assert node.wait_for_end(20.0) == 1
    assert BESIDE in node.log and "Traceback" not in node.log
    assert "Connecting" not in node.log and "connected" not in robot.log


def test_of_devices_whose_node_is_dead_nothing_is_heard(robot, run, announced, monkeypatch):
    """The master still lists the topic of a node that was killed."""
    quick_params(REAL_TIME, robot.port)
    monkeypatch.setattr(RobotAddress, "on_this_machine", False)
    run(REAL_TIME).wait_for_mode("home")


def test_simulated_devices_that_come_later_end_the_controller_of_a_real_arm_which_brakes(
    ros, robot, run, announced, monkeypatch
):
    quick_params(REAL_TIME, robot.port)
    monkeypatch.setattr(RobotAddress, "on_this_machine", False)
    node = run(REAL_TIME)
    node.wait_for_mode("home")
    assert node.control(True).success
    hand = Hand(home_tool())
    node.wait_for_mode("servo")
    hand.T = far = shifted(home_tool(), 0.0, 0.1, 0.0)
    ros.wait_until(lambda: not robot.is_at(home_tool()), 2.0, "the arm on its way")
    announced()
    assert node.wait_for_end(5.0) == 1
    assert BESIDE in node.log and "Traceback" not in node.log
    assert "The connection to the robot is closed." in node.log
    assert not robot.is_at(far) and robot.ask("state")["safety_stop"] is None
