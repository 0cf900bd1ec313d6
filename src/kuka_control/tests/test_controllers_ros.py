"""The two controllers as nodes, on the simulated robot: parameters, services, topics, tf, and how they end."""

from __future__ import annotations

import json
import re
import signal
import socket
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest
import yaml
from loop_world import rig

from common.poses import inverse, pose
from common.rotations import rotation_from_zyx
from kuka_control.model.config import RealTimeConfig

pytestmark = pytest.mark.ros

CONFIG = Path(__file__).parents[1] / "config"
EXAMPLE = str(CONFIG / "dh_parameters_example.yaml")
REAL_TIME, PTP = "real_time_controller.py", "ptp_controller.py"
MOVE_S = 60.0
"""Longest wait for a motion; the machine may be busy."""
QUICK = {
    REAL_TIME: {"velocity_ptp_slow": 0.8, "velocity_ptp_fast": 0.8, "rate_servo": 100.0},
    PTP: {"velocity_ptp": 0.8},
}
"""Quicker motions and fewer goals than in the yaml files, whose values one test has: the others need half the time."""
RATES = {"rate_joints": 25.0, "rate_state": 10.0}
FOLLOWS = ("pick_up", "servo")
SLOW = {"velocity_ptp_slow": 0.15}
"""For what must happen while the arm moves."""
LINK_LOST = "The link to the robot is lost for the moment"


class Robot:
    """The simulated robot, and the truth about it from its control port."""

    def __init__(self, process, port, control_port):
        self.process, self.port = process, port
        self._socket = socket.create_connection(("127.0.0.1", control_port), 5.0)
        self._lines = self._socket.makefile("r")

    def ask(self, what="state", **fields):
        self._socket.sendall((json.dumps({"do": what, **fields}) + "\n").encode())
        answer = json.loads(self._lines.readline())
        assert answer["ok"], answer
        return answer

    @property
    def joints(self):
        return np.array(self.ask()["joints"])

    @property
    def log(self):
        return self.process.log_path.read_text()


@pytest.fixture
def robot(ros, wait_until, request):
    """The simulated robot; a test may add arguments by indirect parameters."""
    return run_robot(ros, wait_until, "--port", "0", "--control-port", "0", *getattr(request, "param", ()))


def run_robot(ros, wait_until, *arguments):
    process = ros.run("rig_simulation", "sunrise_controller.py", *arguments)
    ready = r"listening on 127\.0\.0\.1:(\d+), control port 127\.0\.0\.1:(\d+)"
    found = wait_until(lambda: re.search(ready, process.log_path.read_text()), 20.0, "the simulated robot")
    return Robot(process, int(found[1]), int(found[2]))


class Node:
    """A controller that runs, and what a person does with it."""

    def __init__(self, process, wait_until):
        self.process, self._wait_until = process, wait_until

    def call(self, name, kind, *values):
        import rospy

        import kuka_msgs.srv

        rospy.wait_for_service(f"kuka/{name}", 20.0)
        return rospy.ServiceProxy(f"kuka/{name}", getattr(kuka_msgs.srv, kind))(*values)

    def control(self, on):
        return self.call("kuka_control", "setKukaControl", on)

    def wait_for_mode(self, *modes, timeout=MOVE_S):
        self._wait_until(lambda: self.modes and self.modes[-1].data in modes, timeout, f"mode {modes}")

    def wait_for_end(self, timeout=MOVE_S):
        self._wait_until(lambda: self.process.poll() is not None, timeout, "the end of the node")
        return self.process.returncode

    def engage(self):
        """Switches control on and waits until the arm came home, from where it may at once follow a hand that is still
        shown: where a busy machine lets its frames pause, they count as another stream.
        """
        self.modes.clear()
        answer = self.control(True)
        assert answer.success
        self._wait_until(lambda: "home" in self.moved_through(), MOVE_S, "the arm at home")
        return answer

    def moved_through(self):
        """Returns the modes so far, without that of a controller that is still judging its first motion."""
        return [message.data for message in self.modes if message.data != "starting"]

    @property
    def log(self):
        return self.process.log_path.read_text()


@pytest.fixture
def start(ros, robot, wait_until):
    """Starts a controller on the simulated robot with the parameters of its file and `changes`."""
    from std_msgs.msg import String

    def start_controller(executable=REAL_TIME, quick=True, **changes):
        others = {**QUICK[executable], **RATES} if quick else {}
        set_params(executable, **{"ip": "127.0.0.1", "port": robot.port, "tool_mass": 0.0, **others, **changes})
        node = Node(None, wait_until)
        node.modes = ros.record("kuka/mode", String)
        node.process = ros.run("kuka_control", executable)
        return node

    return start_controller


def set_params(executable, **changes):
    import rospy

    file = CONFIG / ("kuka_params_rt.yaml" if executable == REAL_TIME else "kuka_params_ptp.yaml")
    rospy.set_param("kuka", {**yaml.safe_load(file.read_text()), **changes})


class Hand:
    """Publishes the desired tool frame at 100 Hz until it is hidden."""

    def __init__(self, T, parent_chain=False):
        import rospy
        import tf2_ros

        from common.ros.conversions import stamped_transform

        self.T = T
        self.delay = rospy.Duration(0.0)
        self._stop = threading.Event()
        broadcaster = tf2_ros.TransformBroadcaster()

        def publish():
            while not self._stop.wait(0.01):
                now = rospy.Time.now() + self.delay
                if parent_chain:
                    half = pose(p=self.T[:3, 3] / 2.0)
                    rest = pose(self.T[:3, :3], self.T[:3, 3] / 2.0)
                    broadcaster.sendTransform(
                        [
                            stamped_transform(half, "kuka/base_frame", "leap_motion/virtual_frame", now),
                            stamped_transform(rest, "leap_motion/virtual_frame", "kuka/tool_frame/desired", now),
                        ]
                    )
                else:
                    broadcaster.sendTransform(
                        stamped_transform(self.T, "kuka/base_frame", "kuka/tool_frame/desired", now)
                    )

        self._thread = threading.Thread(target=publish, daemon=True)
        self._thread.start()

    def hide(self):
        self._stop.set()
        self._thread.join()


@pytest.fixture
def hand(wait_until):
    shown = []

    def show(T, **kwargs):
        shown.append(Hand(T, **kwargs))
        return shown[-1]

    def show_again(one, node):
        """The hand leaves the box and comes back, as a stream counts only if it begins after control went on; again
        where the controller of a busy machine has not seen the pause.
        """

        def follows():
            nonlocal one
            one.hide()
            time.sleep(0.5)
            one = show(one.T)
            late = time.monotonic() + 3.0
            wait_until(lambda: node.modes[-1].data in FOLLOWS or time.monotonic() > late, 10.0, "the arm to follow")
            return node.modes[-1].data in FOLLOWS

        wait_until(follows, MOVE_S, "the arm to follow the hand that came back")
        return one

    show.again = show_again
    yield show
    for one in shown:
        one.hide()


def home_tool():
    """Tool at the workspace centre of the default parameters, z down, x back to the base."""
    import rospy

    c = np.sqrt(0.5)
    R = np.column_stack([[-c, c, 0.0], [c, c, 0.0], [0.0, 0.0, -1.0]])
    return pose(R, rospy.get_param("kuka/ws_center"))


def shifted(T, x, y, z):
    T = T.copy()
    T[:3, 3] += (x, y, z)
    return T


def tool_of(robot):
    return np.array(robot.ask()["flange"]) @ pose(p=(0.0, 0.0, 0.106))


def at(robot, T, tolerance=3e-3):
    return np.linalg.norm(tool_of(robot)[:3, 3] - T[:3, 3]) < tolerance


def check_tool_poses(node, robot):
    """Whether the tool can be brought to a pose; the scaling factor is 0.5 and the arm does not move."""
    import rospy

    from common.ros.conversions import pose_from_message, stamped_pose
    from rig_msgs.srv import CheckToolPose

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


def test_the_life_of_the_real_time_controller(ros, robot, start, hand, wait_until):
    import rospy
    import tf2_ros
    from geometry_msgs.msg import Vector3Stamped
    from sensor_msgs.msg import JointState, TimeReference
    from std_msgs.msg import Bool
    from tf2_msgs.msg import TFMessage
    from visualization_msgs.msg import MarkerArray

    from kuka_msgs.msg import jointPositions, jointTorquesExternal, jointTorquesMeasured
    from rig_msgs.msg import KukaStatus

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
    listener = tf2_ros.TransformListener(buffer)
    node = start(quick=False, time_out=2.0)  # a busy machine lets the hand's frames come late

    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, rospy.get_param("kuka/joints_home"), atol=1e-3)
    np.testing.assert_allclose(rospy.get_param("kuka/ws_center"), [0.42214, -0.42214, 0.4], atol=1e-4)
    assert heard["kuka/workspace"].wait()[0].markers
    heard["kuka/flange_torque"].wait()
    for frame in ("kuka/flange_frame/home", "kuka/tool_frame/home", "kuka/flange_frame/measured"):
        wait_until(lambda f=frame: buffer.can_transform("kuka/base_frame", f, rospy.Time(0)), 10.0, frame)
    measured = buffer.lookup_transform("kuka/base_frame", "kuka/flange_frame/measured", rospy.Time(0)).transform
    at_home = buffer.lookup_transform("kuka/base_frame", "kuka/flange_frame/home", rospy.Time(0)).transform
    assert abs(measured.translation.z - at_home.translation.z) < 1e-3

    assert node.call("gripper_control", "setGripperControl", True).success
    wait_until(lambda: heard["kuka/gripper_control"] and heard["kuka/gripper_control"][-1].data, 5.0, "gripper flag")
    assert not node.call("scaling_factor", "setScalingFactor", 1.6).success
    assert not node.call("scaling_factor", "setScalingFactor", float("nan")).success
    assert node.call("scaling_factor", "setScalingFactor", 0.5).message == "The scaling factor is 0.5."
    assert node.control(True).success
    assert not node.call("scaling_factor", "setScalingFactor", 0.7).success

    T_home = home_tool()
    shown = hand(shifted(T_home, 0.1, 0.0, 0.06), parent_chain=True)
    node.wait_for_mode("servo")
    wait_until(lambda: at(robot, shifted(T_home, 0.05, 0.0, 0.03)), 20.0, "the tool at half the way of the hand")
    wait_until(lambda: heard["kuka/moving_rt"][-1].data, 5.0, "moving_rt")

    for messages in heard.values():
        messages.clear()
    for z in np.linspace(0.06, 0.0, 100):
        shown.T = shifted(T_home, 0.1, 0.0, z)
        time.sleep(0.01)
    wait_until(lambda: at(robot, shifted(T_home, 0.05, 0.0, 0.0)), 20.0, "the tool where the hand is")
    assert [m.data for m in node.modes].count("servo") == 1
    frames = [t.child_frame_id for m in heard["/tf"] for t in m.transforms]
    assert frames.count("kuka/flange_frame/measured") > 0.7 * len(heard["joint_states"]), "with the joints in motion"
    for name in ("joint_states", "kuka/joint_positions", "kuka/joint_torques_external", "kuka/joint_torques_measured"):
        heard[name].wait(10)
    heard["kuka/flange_force"].wait(10)
    heard["kuka/flange_torque"].wait(10)
    assert all(m.source == "kuka_control" for m in heard["rig/stage_times"].wait(10))
    assert heard["joint_states"][-1].name == [f"kuka/joint_{i}" for i in range(1, 8)]
    np.testing.assert_allclose(heard["joint_states"][-1].position, robot.joints, atol=0.01)
    commanded = buffer.lookup_transform("kuka/base_frame", "kuka/tool_frame/commanded", rospy.Time(0)).transform
    assert abs(commanded.translation.x - (T_home[0, 3] + 0.05)) < 1e-6
    status = heard["kuka/status"].wait()[-1]
    assert (status.control_on, status.mode, status.scaling_factor) == (True, "servo", pytest.approx(0.5))

    shown.hide()
    node.wait_for_mode("home")
    np.testing.assert_allclose(robot.joints, rospy.get_param("kuka/joints_home"), atol=1e-3)

    answer = node.call("exit_app", "exitApp")
    assert answer.success and "zero" in answer.message
    assert node.wait_for_end() == 0
    np.testing.assert_allclose(robot.joints, np.zeros(7), atol=1e-3)
    modes = ["homing", "home", "pick_up", "servo", "returning", "home", "zero", "stopped"]
    wait_until(lambda: node.moved_through()[-1] == "stopped", 10.0, "the last mode")
    assert node.moved_through() == modes
    del listener


def test_a_safety_stop_is_latched_and_nothing_lurches_when_it_is_released_and_the_emergency_exit_ends_at_once(
    robot, start, hand, wait_until
):
    node = start(time_out=2.0)
    node.wait_for_mode("home")
    assert node.control(True).success
    T_home = home_tool()
    shown = hand(T_home)
    node.wait_for_mode("servo")
    robot.ask("set_external_torque", value=[0, 30, 0, 0, 0, 0, 0])
    wait_until(lambda: robot.ask()["safety_stop"], 10.0, "the safety stop")
    robot.ask("set_external_torque", value=[0] * 7)
    for x in np.linspace(0.0, 0.06, 60):
        shown.T = shifted(T_home, x, 0.0, 0.0)
        time.sleep(0.01)
    node.wait_for_mode("stopped")
    stopped_at = robot.joints
    robot.ask("release")
    time.sleep(1.0)
    np.testing.assert_allclose(robot.joints, stopped_at, atol=2e-3)
    answer = node.control(True)
    assert not answer.success and "off and on again" in answer.message
    assert node.control(False).success
    node.engage()
    shown = hand.again(shown, node)
    node.wait_for_mode("servo")
    wait_until(lambda: at(robot, shown.T), 20.0, "the tool where the hand is")
    assert robot.ask()["stops"] == 1
    assert node.call("exit_app_emergency", "exitAppEmergency").success
    assert node.wait_for_end(10.0) == 2
    assert "connection to the robot is closed" not in node.log, "it leaves the connection alone"


def test_a_motion_that_a_safety_stop_holds_is_said_and_continues_to_its_end_when_it_is_released(
    ros, robot, start, wait_until
):
    from rosgraph_msgs.msg import Log

    said = ros.record("/rosout", Log)
    node = start(**SLOW)
    node.wait_for_mode("homing")
    robot.ask("set_external_torque", value=[0, 30, 0, 0, 0, 0, 0])
    wait_until(lambda: any("does not continue" in m.msg for m in said), 20.0, "the sentence")
    robot.ask("set_external_torque", value=[0] * 7)
    robot.ask("release")
    node.wait_for_mode("stopped")
    assert node.control(True).success
    node.wait_for_mode("home")


def test_bad_frames_do_not_move_the_arm_and_an_infeasible_one_stops_the_controller(
    ros, processes, robot, start, hand, wait_until
):
    import rospy
    from rosgraph_msgs.msg import Log

    said = ros.record("/rosout", Log)
    node = start()
    node.wait_for_mode("home")
    check_tool_poses(node, robot)
    process = processes.start("rosservice", "call", "kuka/scaling_factor", "1.0")
    assert process.wait(30.0) == 0 and "The scaling factor is 1." in process.log_path.read_text()
    assert not node.call("scaling_factor", "setScalingFactor", 0.05).success
    assert node.control(True).success
    at_home = robot.joints
    shown = hand(shifted(home_tool(), float("nan"), 0.0, 0.0))
    wait_until(lambda: any("not finite" in m.msg for m in said), 10.0, "the refusal of NaN")
    shown.T, shown.delay = shifted(home_tool(), 0.1, 0.0, 0.0), rospy.Duration(-2.0 * 3600.0)  # a recording
    wait_until(lambda: any("behind this machine's clock" in m.msg for m in said), 10.0, "the refusal of old stamps")
    np.testing.assert_allclose(robot.joints, at_home, atol=1e-9)
    shown.delay = rospy.Duration(0.0)
    node.wait_for_mode("servo")
    shown.T = shifted(home_tool(), -0.9, 0.9, 0.0)
    assert node.wait_for_end() == 1
    np.testing.assert_allclose(robot.joints, np.zeros(7), atol=1e-3)
    assert "infeasible: it lies behind the base" in node.log
    wait_until(lambda: not robot.ask()["connected"], 5.0, "the end of the connection")


@pytest.mark.parametrize("robot", [("--toolbox-version", version) for version in ("1.7", "2019-03")], indirect=True)
def test_with_a_server_before_may_2019_pose_and_force_are_reckoned(ros, robot, start, hand, wait_until):
    import tf2_ros
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import Vector3Stamped

    from common.ros.conversions import pose_from_transform

    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    node = start(time_out=2.0)
    node.wait_for_mode("home")
    for what in ("pose", "force"):
        assert node.log.count(f"does not tell the {what}, as those before May 2019") == 1
    assert node.control(True).success
    T = shifted(home_tool(), 0.0, 0.03, 0.03)
    hand(T)
    node.wait_for_mode("servo")
    wait_until(lambda: at(robot, T), MOVE_S, "the tool where the hand is")
    measured = frame("kuka/flange_frame/measured", tf2_ros, wait_until, pose_from_transform)
    np.testing.assert_allclose(measured, np.array(robot.ask()["flange"]), atol=3e-3)
    forces = ros.record("kuka/flange_force", Vector3Stamped)
    robot.ask("set_tcp_force", value=[2.0, -3.0, 8.0])
    expected = [2.0, -3.0, 8.0]
    wait_until(
        lambda: forces and np.allclose([getattr(forces[-1].vector, x) for x in "xyz"], expected, atol=0.5),
        20.0,
        "the force from the torques",
    )
    reported = [{v.key: v.value for v in status.values} for m in diagnostics for status in m.status]
    assert any(values.get("estimated_in_servo") == "moment, pose, force" for values in reported)
    late = node.log.count(LINK_LOST)  # on a busy machine
    assert int(reported[-1].get("missed_answers", "0")) <= 2 + late, "an answer may come late, but none is missing"
    assert node.modes[-1].data == "servo"


def test_in_servo_mode_joints_come_with_the_goals_a_jump_is_picked_up_anew_and_an_interrupt_leaves_and_disconnects(
    ros, robot, start, hand, wait_until
):
    from sensor_msgs.msg import JointState

    from kuka_msgs.msg import jointPositions

    node = start(time_out=5.0, rate_joints=2.0)
    node.wait_for_mode("home")
    assert node.control(True).success
    T_home = home_tool()
    shown = hand(T_home)
    node.wait_for_mode("servo")
    states, positions = ros.record("joint_states", JointState), ros.record("kuka/joint_positions", jointPositions)
    states.wait(2), positions.wait(1)
    states.clear(), positions.clear()
    states.wait(8)
    assert len(positions) > 3 * len(states)
    node.modes.clear()
    shown.T = shifted(T_home, 0.0, 0.1, 0.0)
    wait_until(lambda: node.moved_through() == ["pick_up", "servo"], MOVE_S, "the hand to be picked up")
    wait_until(lambda: at(robot, shown.T), 20.0, "the tool where the hand is")
    assert robot.ask()["stops"] == 0
    node.process.send_signal(signal.SIGINT)
    assert node.wait_for_end(15.0) == 0
    wait_until(lambda: not robot.ask()["connected"], 5.0, "the end of the connection")
    assert robot.ask()["mode"] != "servo"
    wait_until(lambda: "the client ended the application" in robot.log, 5.0, "`end`")
    assert "Traceback" not in node.log


ANOTHER = """
import rospy, tf2_ros
from geometry_msgs.msg import TransformStamped
rospy.init_node("another")
message = TransformStamped(child_frame_id="leap_motion/virtual_frame")
message.header.frame_id, message.transform.translation.x, message.transform.rotation.w = "kuka/base_frame", 0.5, 1.0
broadcaster = tf2_ros.TransformBroadcaster()
while not rospy.is_shutdown():
    message.header.stamp = rospy.Time.now()
    broadcaster.sendTransform(message)
    rospy.sleep(0.01)
"""


def test_a_frame_that_two_nodes_publish_stops_the_arm_and_names_both(ros, processes, robot, start, hand, wait_until):
    from rig_msgs.msg import KukaStatus

    node = start(time_out=1.0)
    node.wait_for_mode("home")
    states = ros.record("kuka/status", KukaStatus)
    node.control(True)
    T = shifted(home_tool(), 0.0, 0.0, 0.05)
    hand(T, parent_chain=True)
    node.wait_for_mode("servo")
    wait_until(lambda: at(robot, T), MOVE_S, "the tool where the hand is")
    processes.start(sys.executable, "-c", ANOTHER)
    said = (
        r"The desired tool frame is refused: /another and /test_\S+ both publish leap_motion/virtual_frame; end one of"
    )
    wait_until(lambda: re.search(said, states[-1].reason), 30.0, "the status that names both")
    node.wait_for_mode("stopped")
    assert robot.ask()["stops"] == 0


def test_the_emergency_exit_works_while_the_robot_hangs(robot, start, suspend):
    node = start(**SLOW)
    node.wait_for_mode("homing")
    suspend(robot.process.pid)
    try:
        assert node.call("exit_app_emergency", "exitAppEmergency").success
        assert node.wait_for_end(10.0) == 2
    finally:
        robot.process.send_signal(signal.SIGCONT)


def lose(robot, states, wait_until):
    """Ends the robot's process, and waits until the controller says on kuka/status that it is gone."""
    robot.process.kill()
    wait_until(lambda: states[-1].mode == "stopped" and "out of reach" in states[-1].reason, 20.0, "the status")


def test_a_lost_robot_is_waited_for_and_moves_only_after_control_was_switched_on(ros, robot, start, hand, wait_until):
    from rig_msgs.msg import KukaStatus

    node = start(time_out=5.0)
    node.wait_for_mode("home")
    node.control(True)
    shown = hand(home_tool())
    node.wait_for_mode("servo")
    node.states = ros.record("kuka/status", KukaStatus)
    node.states.wait()
    lose(robot, node.states, wait_until)
    assert not node.states[-1].control_on and "smartPad" in node.states[-1].reason
    refused = node.control(True)
    assert not refused.success and refused.message == "Control stays off: the robot is out of reach."
    wait_until(
        lambda: re.search(r"Try [3-9]\d* failed: no toolbox server", node.states[-1].reason), 60.0, "three tries"
    )
    assert len(re.findall("Try .* failed", node.log)) == 1

    back = run_robot(ros, wait_until, "--port", str(robot.port), "--control-port", "0")
    wait_until(lambda: "connected again" in node.states[-1].reason, 30.0, "the connection")
    node.modes.clear()
    node.states.clear()
    node.states.wait(50)
    assert {(state.mode, state.control_on) for state in node.states} == {("stopped", False)} and not node.modes
    assert not back.joints.any() and back.ask()["connected"]

    assert "goes home first" in node.engage().message
    hand.again(shown, node)
    node.wait_for_mode("servo")
    wait_until(lambda: at(back, home_tool()), MOVE_S, "the tool where the hand is")
    assert node.moved_through()[0] == "homing"

    lose(back, node.states, wait_until)
    answer = node.call("exit_app", "exitApp")
    assert answer.success and "leaves the arm as it is: the robot is out of reach" in answer.message
    assert node.wait_for_end(15.0) == 0
    assert "Traceback" not in node.log


def test_a_frozen_robot_is_waited_for_on_the_same_connection_and_for_a_lost_one_it_waits_until_an_interrupt(
    ros, robot, start, hand, wait_until, suspend
):
    from diagnostic_msgs.msg import DiagnosticArray

    from rig_msgs.msg import KukaStatus

    node = start(time_out=5.0)
    node.wait_for_mode("home")
    node.control(True)
    shown = hand(home_tool())
    node.wait_for_mode("servo")
    states, diagnostics = ros.record("kuka/status", KukaStatus), ros.record("/diagnostics", DiagnosticArray)
    node.modes.clear()

    def holds():
        values = [{v.key: v.value for v in status.values} for m in diagnostics for status in m.status]
        return [int(v["holds"]) for v in values if "holds" in v][-1:]

    named = node.log.count(LINK_LOST)

    def held():
        return node.log.count(LINK_LOST) > named and any("ms; the goals hold" in state.reason for state in states)

    suspend(robot.process.pid)
    long = time.monotonic() + 0.7  # after a second control would go off
    wait_until(lambda: held() or time.monotonic() > long, 10.0, "the hold")
    robot.process.send_signal(signal.SIGCONT)
    wait_until(held, 10.0, "the hold")
    wait_until(lambda: "The robot answers again after" in node.log, 10.0, "the end of the hold")
    wait_until(lambda: any(holds()), 10.0, "the count")
    assert not node.modes and states[-1].mode == "servo"

    suspend(robot.process.pid)
    node.wait_for_mode("stopped")
    wait_until(lambda: "the same connection is probed" in states[-1].reason, 10.0, "the status")
    refused = node.control(True)
    assert not refused.success and refused.message == "Control stays off: the robot does not answer."
    robot.process.send_signal(signal.SIGCONT)
    wait_until(lambda: "connected again" in states[-1].reason, 20.0, "the robot's return")
    truth = robot.ask()
    assert truth["mode"] == "idle" and truth["connected"] and "deaf" not in node.log
    assert node.moved_through() == ["stopped"]
    node.engage()
    hand.again(shown, node)
    node.wait_for_mode("servo")
    assert node.moved_through()[0] == "homing"

    lose(robot, states, wait_until)
    node.process.send_signal(signal.SIGTERM)
    assert node.wait_for_end(15.0) == 0
    assert "Traceback" not in node.log


def test_a_robot_that_is_lost_on_the_way_to_the_end_ends_the_controller(robot, start):
    node = start(**SLOW)
    node.wait_for_mode("home")
    assert node.call("exit_app", "exitApp").success
    node.wait_for_mode("zero")
    robot.process.kill()
    assert node.wait_for_end() == 1
    assert "The robot is out of reach" in node.log and "not at its zero position" in node.log
    assert "Traceback" not in node.log


def test_the_ptp_controller(ros, robot, start, hand, wait_until):
    node = start(PTP, time_out=1.0)
    node.wait_for_mode("home")
    check_tool_poses(node, robot)
    assert node.call("scaling_factor", "setScalingFactor", 1.0).success
    assert node.control(True).success
    T = shifted(home_tool(), 0.05, 0.0, 0.05)
    shown = hand(T)
    wait_until(lambda: at(robot, T), MOVE_S, "the tool where the hand is")
    assert "pick_up" in node.moved_through()
    shown.hide()
    node.wait_for_mode("home")
    assert node.call("exit_app", "exitApp").success
    assert node.wait_for_end() == 0
    np.testing.assert_allclose(robot.joints, np.zeros(7), atol=1e-3)


def test_bad_parameters_are_refused_before_anything_is_connected(ros, robot, start):
    several = {"opening_angle": 190, "velocity_ptp_fast": "fast", "unknown": 1, "center_line": [1, 0, 0.5]}
    for executable, changes, words in (
        (REAL_TIME, several, ["kuka/opening_angle", "kuka/velocity_ptp_fast", "kuka/unknown", "horizontal"]),
        (PTP, {"dh_parameters": "/no/such/arm.yaml"}, ["/no/such/arm.yaml"]),
        (REAL_TIME, {"dh_parameters": EXAMPLE, "robot": "LBR14R820"}, ["LBR7R800", "LBR14R820"]),
    ):
        node = start(executable, **changes)
        assert node.wait_for_end(30.0) == 1
        assert all(word in node.log for word in words), node.log
        assert "Traceback" not in node.log
    assert not robot.ask()["connected"] and not robot.joints.any()


@pytest.mark.parametrize("executable", [REAL_TIME, PTP])
def test_the_workspace_of_a_real_robot_is_not_lifted(ros, wait_until, executable):
    set_params(executable, ip="192.0.2.1")
    node = Node(ros.run("kuka_control", executable, "--lift-workspace"), wait_until)
    assert node.wait_for_end(30.0) == 1
    assert "--lift-workspace is refused: kuka/ip is 192.0.2.1" in node.log and "Connecting" not in node.log


def test_where_the_workspace_is_lifted_the_tool_leaves_it_and_everybody_is_warned(ros, robot, hand, wait_until):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import String

    diagnostics = ros.record("/diagnostics", DiagnosticArray)
    changes = {"ip": "127.0.0.1", "port": robot.port, "tool_mass": 0.0, **QUICK[REAL_TIME], **RATES}
    set_params(REAL_TIME, **changes)
    node = Node(None, wait_until)
    node.modes = ros.record("kuka/mode", String)
    node.process = ros.run("kuka_control", REAL_TIME, "--lift-workspace")
    node.wait_for_mode("home")
    assert "The workspace is lifted" in node.log
    assert node.control(True).success
    below = shifted(home_tool(), 0.0, 0.0, -0.24)
    hand(below)
    wait_until(lambda: at(robot, below), MOVE_S, "the tool below z_lower_limit")
    status = next(s for m in reversed(diagnostics) for s in m.status if s.name == "kuka_control")
    values = {v.key: v.value for v in status.values}
    assert status.level == 1 and "The workspace is lifted" in status.message and values["workspace"] == "lifted"


def test_without_a_robot_it_says_so_and_ends(ros, wait_until, free_port):
    set_params(REAL_TIME, ip="127.0.0.1", port=free_port())
    node = Node(ros.run("kuka_control", REAL_TIME), wait_until)
    assert node.wait_for_end(60.0) == 1
    assert "Trying for" in node.log and "There is no connection to the robot" in node.log
    assert "Traceback" not in node.log


def test_it_waits_for_the_rest_of_its_parameters_and_refuses_an_incomplete_set_in_one_sentence(ros, wait_until):
    """As after leap_kuka_debug.launch, which uploads two keys of another set."""
    import rospy

    rospy.set_param("kuka", {"center_line": [1, 0, 0], "ws_center": [0.5, 0, 0.5]})
    node = Node(ros.run("kuka_control", PTP), wait_until)
    wait_until(lambda: re.search("Waiting for parameters under /kuka/: .*robot", node.log), 30.0, "the sentence")
    assert node.wait_for_end(40.0) == 1
    refused = re.findall(r"kuka/ has only the parameters center_line, ws_center; .*robot.*", node.log)
    assert refused and len(set(refused)) == 1
    assert "is missing; it must be" not in node.log and "Traceback" not in node.log


def test_it_waits_for_parameters_and_says_so_and_takes_what_comes_late(ros, robot, wait_until):
    import rospy
    from rosgraph_msgs.msg import Log
    from std_msgs.msg import String

    said = ros.record("/rosout", Log)
    node = Node(ros.run("kuka_control", PTP), wait_until)
    wait_until(lambda: any("Waiting for the parameter /kuka" in m.msg for m in said), 30.0, "the sentence")
    rospy.set_param("kuka", {"center_line": [1, 0, 0], "ws_center": [0.5, 0, 0.5]})
    modes = ros.record("kuka/mode", String)
    wait_until(lambda: re.search("Waiting for parameters under /kuka/: .*robot", node.log), 30.0, "the sentence")
    set_params(PTP, ip="127.0.0.1", port=robot.port)
    wait_until(lambda: modes, MOVE_S, "a controller that runs")
    assert node.process.poll() is None


def test_simulated_time_without_a_clock_is_said(ros, wait_until):
    import rospy

    rospy.set_param("use_sim_time", True)
    set_params(PTP)
    node = Node(ros.run("kuka_control", PTP), wait_until)
    wait_until(
        lambda: "use_sim_time is true, but nobody publishes /clock within 10 s" in node.log, 30.0, "the sentence"
    )
    assert node.wait_for_end(60.0) == 1
    assert "Traceback" not in node.log


@pytest.mark.parametrize("robot", [("--mounting", "180", "0", "0")], indirect=True)
def test_an_arm_on_a_ceiling_follows_the_hand(ros, robot, start, hand, wait_until):
    import tf2_ros

    from common.ros.conversions import pose_from_transform
    from kuka_msgs.msg import jointTorquesExternal, jointTorquesMeasured

    external = ros.record("kuka/joint_torques_external", jointTorquesExternal)
    measured = ros.record("kuka/joint_torques_measured", jointTorquesMeasured)
    node = start(**yaml.safe_load((CONFIG / "ceiling.yaml").read_text()), time_out=1.0)
    node.wait_for_mode("home")
    home = frame("kuka/tool_frame/home", tf2_ros, wait_until, pose_from_transform)
    np.testing.assert_allclose(home[:3, :3], np.eye(3), atol=1e-6)  # z away from the ceiling
    np.testing.assert_allclose(tool_of(robot), home, atol=2e-3)
    assert node.control(True).success
    T = shifted(home, 0.0, 0.05, 0.05)
    hand(T)
    node.wait_for_mode("servo")
    wait_until(lambda: at(robot, T), MOVE_S, "the tool where the hand is")
    external.wait(3), measured.wait(3)
    assert all(m.joint_1 == m.joint_2 == m.joint_4 == 0.0 for m in external)
    # The weight of the arm, which leans towards center_line, pulls at joint 4 the other way than on the floor.
    assert measured[-1].joint_4 * gravity_on_the_floor(robot.joints)[3] < 0.0


def test_a_tool_that_is_a_whole_pose(ros, robot, start, hand, wait_until):
    import tf2_ros

    from common.ros.conversions import pose_from_transform

    T_flange_tool = pose(rotation_from_zyx(0.4, 0.3, -0.2), (0.02, -0.03, 0.1))
    node = start(use_tool_transform=True, tool_transform=T_flange_tool.ravel().tolist(), time_out=1.0)
    node.wait_for_mode("home")
    T_home = home_tool()
    for name, expected in (
        ("kuka/tool_frame/home", T_home),
        ("kuka/flange_frame/home", T_home @ inverse(T_flange_tool)),
        ("kuka/flange_frame/measured", T_home @ inverse(T_flange_tool)),
    ):
        wait_until(
            lambda name=name, expected=expected: np.allclose(
                frame(name, tf2_ros, wait_until, pose_from_transform), expected, atol=2e-3
            ),
            20.0,
            name,
        )
    assert node.control(True).success
    T = shifted(T_home, 0.03, 0.0, 0.05)
    hand(T)
    node.wait_for_mode("servo")
    wait_until(
        lambda: np.allclose(np.array(robot.ask()["flange"]) @ T_flange_tool, T, atol=3e-3),
        MOVE_S,
        "the tool at the hand",
    )


def test_a_calibrated_arm_has_its_home_and_its_measured_flange_by_its_own_parameters(ros, robot, wait_until):
    """The simulated arm is as in the data sheet; its joints are those that the controller chose for another."""
    import rospy
    import tf2_ros
    from std_msgs.msg import String

    from common.ros.conversions import pose_from_transform

    modes = ros.record("kuka/mode", String)
    own = {"port": robot.port, "dh_parameters": EXAMPLE, "gui": "false"}
    ros.launch("kuka_control", "real_time_controller.launch", ip="127.0.0.1", **own)
    wait_until(lambda: modes and modes[-1].data == "home", MOVE_S, "the arm at home")
    assert rospy.get_param("kuka/dh_parameters") == EXAMPLE and rospy.get_param("kuka/tool_length") == 0.106
    home = frame("kuka/flange_frame/home", tf2_ros, wait_until, pose_from_transform)
    np.testing.assert_allclose(home[:3, 3] - [0.0, 0.0, 0.106], rospy.get_param("kuka/ws_center"), atol=1e-6)
    measured = frame("kuka/flange_frame/measured", tf2_ros, wait_until, pose_from_transform)
    np.testing.assert_allclose(measured[:3, 3], home[:3, 3], atol=1e-4)
    assert 5e-4 < np.linalg.norm(np.array(robot.ask()["flange"])[:3, 3] - home[:3, 3]) < 5e-3


def frame(name, tf2_ros, wait_until, pose_from_transform):
    """Returns the pose of a frame in the base, shape (4, 4) [m]."""
    import rospy

    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    wait_until(lambda: buffer.can_transform("kuka/base_frame", name, rospy.Time(0)), 20.0, f"tf of {name}")
    listener.unregister()
    return pose_from_transform(buffer.lookup_transform("kuka/base_frame", name, rospy.Time(0)).transform)


def gravity_on_the_floor(q):
    """Returns the joint torques that hold an arm on the floor, shape (7,) [Nm]."""
    from rig_simulation.devices.sunrise.robot import Robot
    from rig_simulation.files import read_urdf

    return Robot(read_urdf("LBR7R800", "MF_elektrisch")).torques(q, np.zeros(7), np.zeros(7))


def test_the_centre_of_the_workspace_is_uploaded_last_as_leap_kuka_expects(ros, monkeypatch):
    """What came between its two readings of the parameters was an unknown key, and ended it."""
    from kuka_control.ros import controller_node

    uploaded = []
    nothing = types.SimpleNamespace(spin=lambda _: None, close=lambda: None)
    with monkeypatch.context() as patch:
        for name in ("RobotLink", "_Node"):
            patch.setattr(controller_node, name, lambda *_: nothing)
        patch.setattr(controller_node, "wait_for_config", lambda *_, **__: rig(RealTimeConfig)[0])
        patch.setattr(controller_node.rospy, "set_param", lambda key, _: uploaded.append(key))
        controller_node._run(RealTimeConfig, lambda *_: None, types.SimpleNamespace(lift_workspace=False))
    assert uploaded == ["kuka/joints_home", "kuka/rotation_home", "kuka/ws_center"]
