"""The node grasp_execution between a controller, a teleoperation and a robot hand that are made up."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import clock
from common.poses import pose, translation

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from common.ros.conversions import message_from_pose, pose_from_message, pose_in, stamped_pose, stamped_transform
from grasp_msgs.msg import Grasp, GraspList, GraspOutcome
from grasping.ros.execution_io import hand_measurement
from reflex_msgs.msg import Hand
from rig_msgs.msg import KukaStatus, TeleopState
from rig_msgs.srv import CheckToolPose, CheckToolPoseResponse, HoldTool

pytestmark = pytest.mark.ros

FOLDER = Path(__file__).parents[1]
CONFIG = yaml.safe_load((FOLDER / "config" / "execution.yaml").read_text())
TOOL_POSE = yaml.safe_load((FOLDER / "config" / "tool_pose.yaml").read_text())
ARM = {"center_line": [1.0, 0.0, 0.0], "tool_length": 0.1}
DOWN = np.diag([-1.0, 1.0, -1.0])
GRASP = pose(DOWN, (0.5, 0.1, 0.2))
ABOVE = pose(DOWN, (0.5 - 0.0152, 0.1, 0.2 + 0.07 + 0.12))
HOME = pose(DOWN, (0.5, 0.0, 0.5))
RIG_S, NODE_S, LATER_S = 0.05, 0.05, 0.01
"""Periods of the rig and of the node, and how much later messages come and go."""
KNOWN_S = RIG_S + NODE_S + LATER_S
"""How long the node takes at most to act on what the rig publishes."""


class Rig:
    """Publishes the values that the test sets, 20 times a second, except on topics that are silent."""

    def __init__(self):
        def publisher(topic, kind, latch=False):
            return rospy.Publisher(topic, kind, queue_size=10, latch=latch)

        self._tf, self._hand = publisher("/tf", TFMessage), publisher("reflex_takktile/hand_state", Hand)
        self._status, self._grasps = publisher("kuka/status", KukaStatus), publisher("ggcnn/out/grasps", GraspList)
        self._teleop = publisher("leap_kuka/state", TeleopState, latch=True)
        self.tool, self.fingers, self.control_on, self.mode = HOME, (0.0, 0.0), True, "home"
        self.grasps, self.why_none, self.hold = [self.grasp(7)], "", "none"
        self.out_of_reach, self.not_held = "", ""
        self.checked, self.held, self.silent = [], [], set()
        self.answers = clock.Event()
        self.answers.set()
        self._services = [
            rospy.Service("kuka/check_tool_pose", CheckToolPose, self._check),
            rospy.Service("leap_kuka/hold_tool", HoldTool, self._hold),
        ]
        self.say_hold("none")
        self._stop = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    @staticmethod
    def grasp(number, T=GRASP, reachable=True):
        return Grasp(
            id=number, pose_base=stamped_pose(T, "kuka/base_frame", rospy.Time.now()), width=0.06, reachable=reachable
        )

    def say_hold(self, hold, reason="no hand is seen"):
        self.hold = hold
        state = {"taken": TeleopState.RUNNING, "none": TeleopState.WAITING}.get(hold, TeleopState.HOLDING)
        self._teleop.publish(TeleopState(state=state, hold=hold, reason=reason))

    def end(self):
        self.answers.set()
        self._stop.set()
        self._thread.join()
        for service in self._services:
            service.shutdown()
        for topic in (self._tf, self._hand, self._status, self._grasps, self._teleop):
            topic.unregister()

    def _check(self, request):
        self.answers.wait()
        T = pose_from_message(request.tool.pose)
        self.checked.append(T)
        if self.out_of_reach:
            return CheckToolPoseResponse(success=False, message=self.out_of_reach)
        return CheckToolPoseResponse(success=True, desired=message_from_pose(translation(0.0, 0.01, 0.0) @ T))

    def _hold(self, request):
        if request.duration == 0.0:
            self.held.append(None)
            self.say_hold("none", "the tool is held no longer: it was ended")
            return True, "The hold has ended."
        self.held.append((pose_in("kuka/base_frame", request.tool), request.duration))
        if self.not_held:
            return False, self.not_held
        self.say_hold("held")
        return True, "The tool is held."

    def _loop(self):
        while not self._stop.wait(RIG_S):
            now = rospy.Time.now()
            T = self.tool @ translation(0.0, 0.0, -0.1)
            hand = Hand()
            for i in range(3):
                hand.motor[i].joint_angle, hand.finger[i].pressure[3] = self.fingers
            grasps = GraspList(grasps=self.grasps, reason=self.why_none)
            grasps.header.stamp = now
            for topic, message in (
                (self._tf, TFMessage([stamped_transform(T, "kuka/base_frame", "kuka/flange_frame/measured", now)])),
                (self._hand, hand),
                (self._status, KukaStatus(control_on=self.control_on, mode=self.mode, reason="So it is.")),
                (self._grasps, grasps),
            ):
                if topic.name not in self.silent:
                    topic.publish(message)


@pytest.fixture
def rig(ros):
    rig = Rig()
    yield rig
    rig.end()


@pytest.fixture
def node(ros):
    class Node:
        states = ros.record("grasping/state", DiagnosticStatus)
        outcomes = ros.record("grasping/outcome", GraspOutcome)
        markers = ros.record("grasping/proposal_marker", MarkerArray)

        def start(self, arm=ARM, **changes):
            rospy.set_param("kuka", arm)
            rospy.set_param("grasp_execution", {**CONFIG, "tool_pose": TOOL_POSE, **changes})
            self.process = ros.run("grasping", "grasp_execution.py")
            return self

        def ask(self, what):
            answer = rospy.ServiceProxy(f"grasping/{what}", Trigger)()
            return True if answer.success else answer.message

        def reaches(self, state):
            clock.sleep(KNOWN_S)
            assert self.now["state"] == state, self.now

        @property
        def now(self):
            return {v.key: v.value for v in self.states[-1].values}

        @property
        def log(self):
            return self.process.log_path.read_text()

    return Node()


@pytest.fixture
def asked(ros, rig, node):
    """A node that the launch file started, and that executes a grasp."""
    rospy.set_param("kuka", ARM)
    (node.process,) = ros.launch("grasping", "execution.launch").nodes
    clock.sleep(2 * KNOWN_S)
    assert node.ask("execute") is True
    return node


def test_a_grasp_from_the_proposal_to_the_label(ros, rig, asked):
    node = asked
    node.reaches("approaching")
    assert (node.now["proposal"], node.now["episode"]) == ("7", "1")
    np.testing.assert_allclose(rig.checked[-2], translation(0.0, 0.0, -0.12) @ ABOVE, atol=1e-6)
    np.testing.assert_allclose(rig.checked[-1], ABOVE, atol=1e-6)
    desired, duration = rig.held[-1]
    np.testing.assert_allclose(desired, translation(0.0, 0.01, 0.0) @ ABOVE, atol=1e-6)
    assert duration == CONFIG["wait_for_hand"]
    assert "7 is being executed; cancel it first" in node.ask("execute")
    assert len(node.markers[-1].markers) == 6

    rig.tool, rig.mode = ABOVE, "servo"
    node.reaches("waiting_for_hand")
    rig.say_hold("taken", "right hand 12 is followed")
    node.reaches("person")
    rig.tool = closed_at = translation(0.0, 0.0, -0.12) @ ABOVE
    clock.sleep(KNOWN_S)
    rig.fingers, bent, rest = (1.2, 30.0), clock.time(), CONFIG["watch"]["rest_time"]
    closed = "The fingers have closed; now lift."
    ros.wait_until(lambda: node.now["reason"] == closed, rest + KNOWN_S + NODE_S, "closed fingers")
    closed_after = clock.time() - bent
    assert closed_after > rest
    rig.tool, lifted = translation(0.0, 0.0, 0.08) @ closed_at, clock.time()
    hold = CONFIG["watch"]["hold_time"]
    outcome = node.outcomes.wait(1, hold + KNOWN_S + NODE_S)[0]
    assert clock.time() - lifted > hold
    assert outcome.held and outcome.reason == "The thumb and a finger felt something when the tool was 80 mm higher."
    assert (outcome.episode, outcome.proposal.id, outcome.tool.header.frame_id) == (1, 7, "kuka/base_frame")
    assert outcome.tool.pose.position.z == pytest.approx(closed_at[2, 3], abs=1e-6)
    assert rest < outcome.header.stamp.to_sec() - bent < closed_after
    node.reaches("over")
    assert len(node.markers[-1].markers) == 1
    assert rig.held[-1] is not None

    rig.say_hold("none", "right hand 12 was lost")
    rig.tool = HOME
    clock.sleep(KNOWN_S)
    assert node.ask("execute") is True
    assert node.ask("cancel") is True
    node.reaches("over")
    assert len(node.outcomes) == 2 and node.outcomes[1].episode == 2
    assert not node.outcomes[1].held and node.outcomes[1].tool.header.frame_id == ""
    assert rig.held[-1] is None
    assert node.ask("cancel") is True and len(node.outcomes) == 2


def test_what_is_refused(rig, node):
    rig.not_held = "The tool is not held: a hand is followed."
    node.start()
    clock.sleep(2 * KNOWN_S)

    def refused(sentence):
        clock.sleep(KNOWN_S)
        assert str(node.ask("execute")).startswith(sentence)

    rig.grasps, rig.out_of_reach = [rig.grasp(3, reachable=False), rig.grasp(4)], "The outer sphere would move it."
    refused("The outer sphere would move it.")
    rig.out_of_reach = ""
    refused("The tool is not held: a hand is followed.")
    rig.answers.clear()
    began, answers = clock.monotonic(), []
    other = clock.Thread(target=lambda: answers.append(node.ask("execute")))
    other.start()
    refused("Another execution is being requested.")
    other.join()
    unknown = (
        "It is unknown whether the arm reaches the grasp: the service kuka/check_tool_pose did not answer within 3 s"
    )
    assert answers[0].startswith(unknown)
    assert CONFIG["answer_time"] <= clock.monotonic() - began <= CONFIG["answer_time"] + LATER_S
    rig.answers.set()
    rig.silent = {"/ggcnn/out/grasps"}
    clock.sleep(CONFIG["fresh"] - 3 * KNOWN_S)
    refused("The tool is not held")
    clock.sleep(2 * KNOWN_S)
    refused("The newest proposal is 2.")
    rig.silent = {"/kuka/status"}
    clock.sleep(CONFIG["silence"] - 3 * KNOWN_S)
    refused("The tool is not held")
    clock.sleep(2 * KNOWN_S)
    refused("The arm's controller is silent.")
    rig.silent = set()
    rig.say_hold("taken")
    refused("The arm follows a hand; take it away first.")
    assert not node.outcomes and node.now["state"] == "idle"


def test_a_hold_that_ends_is_named_with_the_reason_of_the_teleoperation(rig, asked):
    clock.sleep(NODE_S + LATER_S)  # it has seen the hold
    rig.say_hold("none", "control of the arm is off")
    outcome = asked.outcomes.wait(1, KNOWN_S)[0]
    assert outcome.reason == "The tool was not held for a hand: control of the arm is off."


def test_ctrl_c_tells_the_outcome_and_lets_the_tool_go(rig, asked):
    asked.process.send_signal(signal.SIGINT)
    assert asked.process.wait(NODE_S + LATER_S) == 0
    assert asked.outcomes[0].reason == "The node grasp_execution ended."
    assert rig.held[-1] is None and "Traceback" not in asked.log


@pytest.mark.parametrize(
    ("topic", "sentence"),
    [("/kuka/status", "The arm's controller is silent."), ("/tf", "The pose of the tool is unknown.")],
)
def test_silence_ends_the_execution(rig, asked, topic, sentence):
    rig.silent, began = {topic}, clock.monotonic()
    outcome = asked.outcomes.wait(1, CONFIG["silence"] + NODE_S + LATER_S)[0]
    assert outcome.reason == sentence and clock.monotonic() - began >= CONFIG["silence"] - RIG_S
    clock.sleep(LATER_S)
    assert rig.held[-1] is None, "the tool waits no longer"


@pytest.mark.parametrize(
    "changes, arm, sentence",
    [
        ({"tool_pose": {}}, ARM, "~tool_pose/"),
        ({}, {**ARM, "center_line": [0.0, 0.0, 0.0]}, "center_line is the zero vector"),
    ],
)
def test_a_bad_parameter_ends_the_node_with_a_sentence(node, changes, arm, sentence):
    node.start(arm, **changes)
    assert node.process.wait(LATER_S) == 1
    assert sentence in node.log and "Traceback" not in node.log


def test_without_an_arm_it_waits_and_says_so(node):
    node.start(arm={"robot": "LBR7R800"})
    clock.sleep(10.0)
    assert "Waiting for the parameter /kuka/" in node.log
    node.process.send_signal(signal.SIGINT)
    assert node.process.wait(0.2 + LATER_S) == 0


def test_diagnostics_say_which_inputs_do_not_come(ros, rig, node):
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def says(level, sentence, after=CONFIG["silence"] + 1.1):
        clock.sleep(after)
        last = [status for array in arrays for status in array.status if status.name == "grasp_execution"][-1]
        assert last.level == level and sentence in last.message

    node.start()
    rig.say_hold("none")
    says(DiagnosticStatus.WARN, "No grasp can be executed: nothing has come on /leap_kuka/state for ")
    rig.silent = {"/kuka/status", "/ggcnn/out/grasps"}
    says(DiagnosticStatus.WARN, "/ggcnn/out/grasps, /kuka/status, /leap_kuka/state for ")
    assert node.process.log_path.read_text().count("/leap_kuka/state for ") == 2
    rig.silent = set()
    for _ in range(4):
        rig.say_hold("none")
        clock.sleep(0.5)
    says(DiagnosticStatus.OK, "No grasp was executed yet.", after=0.1)


def test_the_hand_is_measured_by_its_three_fingers():
    message = Hand()
    for i, motor in enumerate(message.motor):
        motor.joint_angle, motor.load = 0.1 * i, 10.0 * i
    message.finger[2].pressure[3] = 5.0
    found = hand_measurement(message)
    np.testing.assert_allclose(found.angles, (0.0, 0.1, 0.2), atol=1e-6)
    np.testing.assert_allclose(found.loads, (0.0, 10.0, 20.0))
    assert found.pressures.shape == (3, 9) and found.pressures[2, 3] == 5.0
