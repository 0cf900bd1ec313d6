"""The node leap_kuka_node in virtual time, with hands made by hand."""

import os
import select
import signal
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from common import clock
from leap_kuka.operator_devices import EV_KEY, EVENT, KEYS

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import TimeReference
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from common.poses import inverse, pose
from common.ros.conversions import message_from_pose, pose_from_transform, stamped_pose, stamped_transform
from common.ros.node import repeat
from common.ros.policy_input import PolicyInput
from leap_kuka.ros import operator_input_node
from leap_motion.msg import Hand, Human
from rig_msgs.msg import KukaStatus, OperatorInput, PolicyActions, TeleopState
from rig_msgs.srv import HoldTool

pytestmark = pytest.mark.ros

SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_params.yaml").read_text())
ARM = {"center_line": [1, 0, 0], "z_lower_limit": 0.2, "tool_length": 0.106, "ws_center": [0.5, 0, 0.4]}
TF_ROUNDING_NS = 1
"""A stamp that went through tf2's buffer can come out a nanosecond earlier."""
PERIOD_S = 0.02
DELAY_S = 0.005
"""Two messages take at most so long."""

PARENTS = {
    "leap_motion/virtual_frame": "kuka/base_frame",
    "hand/frame": "leap_motion/virtual_frame",
    "hand/frame/filtered": "leap_motion/virtual_frame",
    "kuka/tool_frame/desired": "leap_motion/virtual_frame",
    "kuka/flange_frame/desired": "leap_motion/virtual_frame",
}
OF_A_HAND = {"hand/frame", "hand/frame/filtered"}


class Tracker:
    """Publishes Human messages at 50 Hz, with the hands that `show` was given last."""

    def __init__(self):
        self._publisher = rospy.Publisher("leap_motion/leap_device", Human, queue_size=10)
        self._hands = ()
        self._number = 0
        self._next = clock.monotonic() + PERIOD_S
        self.age = 0.0
        self.stamps = set()
        clock.Thread(target=self._loop, daemon=True).start()

    def show(self, *hands):
        self._hands = hands

    def pause(self, seconds):
        """Lets the next frame come so long after the newest one."""
        self._next += seconds - PERIOD_S
        return self._next - seconds

    def _loop(self):
        while True:
            while (left := self._next - clock.monotonic()) > 1e-6:
                clock.sleep(min(left, 1e-3))
            self._next += PERIOD_S
            self._publish()

    def _publish(self):
        self._number += 1
        human = Human(lmc_frame_id=self._number, nr_of_hands=len(self._hands))
        human.header.frame_id = "leap_hands"
        human.header.stamp = rospy.Time.now() - rospy.Duration(self.age)
        for hand, is_left in self._hands:
            setattr(human, "left_hand" if is_left else "right_hand", hand)
        self.stamps.add(human.header.stamp)
        self._publisher.publish(human)


@pytest.fixture
def tracker(ros):
    return Tracker()


@pytest.fixture
def hand(sample):
    """Makes a hand as `sample` does, as (message, is_left)."""

    def make(**changes):
        s = sample(**changes)
        message = Hand(lmc_hand_id=s.id, is_present=True, confidence=s.confidence)
        message.palm_center, message.direction, message.normal = (
            Point(*s.palm),
            Vector3(*s.direction),
            Vector3(*s.normal),
        )
        return message, s.is_left

    return make


def set_params(leap=None, arm=None):
    """Sets the shipped parameters with these changes; None leaves one out."""
    values = {**SHIPPED, **(leap or {})}
    rospy.set_param("leap", {key: value for key, value in values.items() if value is not None})
    rospy.set_param("kuka", {"robot": "LBR7R800", **ARM, **(arm or {})})


@pytest.fixture
def node(ros):
    """The node with its topics recorded."""

    class Node:
        tf = ros.record("/tf", TFMessage)
        stream = ros.record("leap_kuka/stream", DiagnosticStatus)
        markers = ros.record("leap_kuka/interaction_box", MarkerArray)
        diagnostics = ros.record("/diagnostics", DiagnosticArray)
        times = ros.record("rig/stage_times", TimeReference)

        @staticmethod
        def start():
            return ros.run("leap_kuka", "leap_kuka_node.py")

        def run(self):
            """Starts it, and waits until it has read its parameters."""
            process = self.start()
            ros.wait_until(lambda: self.stream, 5.0, "the node")
            return process

        def values(self, key):
            return [{v.key: v.value for v in m.values}[key] for m in self.stream]

        def states(self):
            return self.values("state")

        def owner(self):
            return self.values("hand_id")[-1], self.values("hand_side")[-1]

        def children(self):
            return {t.child_frame_id for t in self.tf[-1].transforms} if self.tf else set()

        def desired(self):
            """The poses T_base_virtual and T_virtual_tool of the newest message with a desired tool, or None."""
            for message in reversed(self.tf):
                found = {t.child_frame_id: pose_from_transform(t.transform) for t in message.transforms}
                if "kuka/tool_frame/desired" in found:
                    return found["leap_motion/virtual_frame"], found["kuka/tool_frame/desired"]
            return None

    return Node()


def took(ros, condition, what, begun=None):
    """How long it takes until the condition is true [s]."""
    begun = clock.monotonic() if begun is None else begun
    ros.wait_until(condition, 10.0, what, poll=0.001)
    return clock.monotonic() - begun


def test_a_hand_is_followed_lost_and_followed_again(ros, node, tracker, hand):
    set_params()
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    node.run()
    clock.sleep(0.1)
    assert node.children() == {"leap_motion/virtual_frame"} and set(node.states()) == {"waiting"}

    tracker.show(hand(yaw=50.0))
    ros.wait_until(lambda: "kuka/flange_frame/desired" in node.children(), 5.0, "the desired flange")
    clock.sleep(DELAY_S)
    followed = node.stream[-1]
    assert followed.level == 0 and "right hand 12 is followed" in followed.message
    assert node.states()[-1] == "running" and node.owner() == ("12", "right")
    message = next(m for m in node.tf if any(t.child_frame_id == "kuka/flange_frame/desired" for t in m.transforms))
    assert {t.child_frame_id: t.header.frame_id for t in message.transforms} == PARENTS
    assert len({t.header.stamp for t in message.transforms}) == 1
    assert message.transforms[0].header.stamp in tracker.stamps

    desired = buffer.lookup_transform("kuka/base_frame", "kuka/tool_frame/desired", rospy.Time(0))
    assert min(abs((desired.header.stamp - stamp).to_nsec()) for stamp in tracker.stamps) <= TF_ROUNDING_NS
    t, q = desired.transform.translation, desired.transform.rotation
    np.testing.assert_allclose([t.x, t.y, t.z], [0.5, 0.0, 0.4], atol=1e-6)
    np.testing.assert_allclose(np.abs([q.x, q.y, q.z, q.w]), [0, 1, 0, 0], atol=1e-6)
    flange = buffer.lookup_transform("kuka/base_frame", "kuka/flange_frame/desired", rospy.Time(0))
    assert flange.transform.translation.z == pytest.approx(0.506, abs=1e-6)
    ros.wait_until(lambda: node.times, 0.2, "a stage time")
    assert node.times[-1].source == "leap_kuka" and node.times[-1].header.stamp in tracker.stamps
    listener.unregister()

    tracker.show()
    lost = took(ros, lambda: node.states()[-1] == "waiting", "the end of the stream")
    assert 0.2 - PERIOD_S <= lost <= 0.2 + 2.0 * PERIOD_S + DELAY_S
    assert (node.stream[-1].level, node.stream[-1].message) == (1, "right hand 12 was lost")
    assert node.owner() == ("", "") and node.children() == {"leap_motion/virtual_frame"}


def test_the_service_holds_a_tool_that_is_given_in_the_arms_frame_until_control_goes_off(ros, node, tracker):
    set_params()
    node.run()
    hold = rospy.ServiceProxy("leap_kuka/hold_tool", HoldTool)
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1, latch=True)
    T = pose(np.diag([-1.0, 1.0, -1.0]), (0.4, 0.1, 0.3))
    tool = stamped_pose(T, "kuka/base_frame", rospy.Time())
    clock.sleep(0.5)
    for on in (False, True):
        status.publish(KukaStatus(control_on=on, mode="home"))
        clock.sleep(0.1)
    refused = hold(stamped_pose(T, "camera_link", rospy.Time()), 30.0)
    assert not refused.success and "instead of kuka/base_frame" in refused.message
    assert hold(tool, 120.0).success
    clock.sleep(0.1)
    assert node.values("hold")[-1] == "held" and node.children() == set(PARENTS) - OF_A_HAND
    T_base_virtual, T_virtual_tool = node.desired()
    np.testing.assert_allclose(T_base_virtual @ T_virtual_tool, T, atol=1e-6)
    status.publish(KukaStatus(control_on=False))
    ended = took(ros, lambda: node.values("hold")[-1] == "none", "the end with control")
    assert ended <= PERIOD_S + 2.0 * DELAY_S
    assert hold(tool, 0.0).success


def test_a_silent_tracker_ends_the_stream_after_200_ms_and_nothing_is_sent_again(ros, node, tracker, hand):
    set_params()
    tracker.show(hand())
    node.run()
    clock.sleep(1.0)
    node.stream.clear()
    tracker.pause(0.19)
    clock.sleep(1.0)
    assert set(node.states()) == {"running"}
    tracker.pause(0.21)
    clock.sleep(1.0)
    assert node.states()[-1] == "waiting"
    came_in = [hand(position=(0.0, 0.35, z)) for z in (0.3, 0.0)]
    for each in came_in:
        tracker.show(each)
        clock.sleep(1.0)
    assert node.states()[-1] == "running"
    silent_since = tracker.pause(100.0)
    silence = took(ros, lambda: node.states()[-1] == "waiting", "the end of the stream", silent_since)
    assert 0.2 <= silence <= 0.2 + 0.1 + 2.0 * DELAY_S
    assert node.stream[-1].message == "no tracking frames come in"
    node.stream.clear()
    clock.sleep(5.0)
    assert 8 <= len(node.stream) <= 10, "the heartbeat of HEARTBEAT_S, seen every 0.1 s"
    stamps = [message.transforms[0].header.stamp for message in node.tf]
    assert len(set(stamps)) == len(stamps) and set(stamps) <= tracker.stamps
    status = node.diagnostics[-1].status[0]
    values = {v.key: v.value for v in status.values}
    assert (status.name, values["state"], values["streams"]) == ("leap_kuka", "waiting", "2")


def test_frames_with_stamps_older_than_half_a_second_are_not_sent_on(ros, node, tracker, hand):
    set_params()
    tracker.age = 0.51
    tracker.show(hand())
    node.run()
    clock.sleep(2.0)
    assert not node.tf and "the stamps of the tracking frames are 0.5 s old" in node.stream[-1].message
    tracker.age = 0.49
    clock.sleep(2.0)
    assert node.states()[-1] == "running"


def test_the_box_is_shown_in_the_colour_of_the_state_with_the_reason(ros, node, tracker, hand):
    set_params()
    tracker.show(hand(pitch=40.0))
    node.run()
    clock.sleep(1.0)
    box, text = node.markers[-1].markers
    assert "pitch is 40" in text.text
    assert box.header.frame_id == text.header.frame_id == "leap_motion/virtual_frame"
    np.testing.assert_allclose([box.pose.position.x, box.pose.position.y, box.pose.position.z], [0, 0.35, 0])
    corners = np.array([[p.x, p.y, p.z] for p in box.points])
    assert len(corners) == 24, "the box has twelve edges"
    np.testing.assert_allclose(np.linalg.norm(corners[::2] - corners[1::2], axis=1), 0.2)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-0.1] * 3, [0.1] * 3])
    tracker.show(hand())
    ros.wait_until(lambda: node.markers[-1].markers[0].color != box.color, 2.0, "the other colour")
    assert "is followed" in node.markers[-1].markers[1].text


def test_the_node_waits_for_the_controller_and_says_so(ros, node, tracker):
    set_params()
    rospy.delete_param("kuka/ws_center")
    process = node.start()
    clock.sleep(60.0)
    assert "/kuka/ws_center" in process.log_path.read_text() and process.poll() is None and not node.tf
    rospy.set_param("kuka/ws_center", ARM["ws_center"])
    ros.wait_until(lambda: node.tf, 5.0, "the frames")


def test_bad_parameters_end_the_node_with_a_sentence(ros, node):
    set_params({"z_clearance": 0.0}, {"ws_center": [0.5, 0, 0.21]})
    process = node.start()
    assert process.wait(5.0) == 1
    log = process.log_path.read_text()
    assert "Traceback" not in log and "leap/z_clearance" in log and not node.tf


def test_the_debug_launch_file_runs_without_a_controller(ros, node, tracker, hand):
    tracker.show(hand(position=(0.0, 0.45, 0.0)))
    ros.launch("leap_kuka", "leap_kuka_debug.launch", driver="false")
    ros.wait_until(node.desired, 5.0, "the desired tool")


RELATIVE = {"engagement": "relative", "hold_time": 60.0, "clutch": "device", "enabling": "device"}


class Pedal:
    """A FIFO as the input device of the node operator_input_node."""

    def __init__(self, path):
        self._path, self._file = path, None
        os.mkfifo(path)
        self.plug()

    def plug(self):
        self._file = os.open(self._path, os.O_RDWR | os.O_NONBLOCK)

    def write(self, *keys):
        os.write(self._file, b"".join(EVENT.pack(0, 0, EV_KEY, KEYS[key], value) for key, value in keys))

    def unplug(self):
        if self._file is not None:
            os.close(self._file)
            self._file = None


@pytest.fixture
def pedal(ros, tmp_path, monkeypatch):
    """The pedal, with the node as its `process`, which waits for it in virtual time."""

    def waits(files, _outputs, _errors, timeout):
        end = clock.monotonic() + timeout
        while not (ready := select.select(files, [], [], 0.0)[0]) and clock.monotonic() < end:
            clock.sleep(0.001)
        return ready, [], []

    monkeypatch.setattr(operator_input_node, "select", SimpleNamespace(select=waits))
    pedal = Pedal(tmp_path / "event-kbd")
    keys = {"device": str(tmp_path / "event-kbd"), "enable_key": "KEY_F13", "clutch_key": "KEY_B"}
    set_params({**RELATIVE, "operator_input": keys})
    pedal.process = ros.run("leap_kuka", "operator_input_node.py")
    yield pedal
    pedal.unplug()


def test_a_pedal_is_read_unplugged_and_plugged_in_again(ros, pedal):
    inputs = ros.record("leap_kuka/operator_input", OperatorInput)

    def newest():
        return (inputs[-1].enabled, inputs[-1].clutch, inputs[-1].source) if inputs else None

    def becomes(expected, within):
        assert took(ros, lambda: newest() == expected, f"{expected}") <= within

    at_once, debounced, retried = 0.001 + DELAY_S, 0.02 + 0.011 + DELAY_S, 1.0 + 0.011 + DELAY_S
    ros.wait_until(inputs.__len__, 5.0, "the node")
    assert newest() == (False, True, "pedal"), "a clutch that was not used yet"
    pedal.write(("KEY_B", 1), ("KEY_B", 0))
    becomes((False, False, ""), debounced)
    pedal.write(("KEY_F13", 2))
    clock.sleep(0.2)
    assert newest() == (False, False, ""), "an automatic repetition is no press"
    pedal.write(("KEY_F13", 1))
    becomes((True, False, "pedal"), debounced)
    pedal.write(("KEY_B", 1))
    becomes((True, True, "pedal"), at_once)
    count = len(inputs)
    clock.sleep(10.0)
    assert 90 <= len(inputs) - count <= 100, "ten times a second"
    pedal.unplug()
    becomes((False, True, "pedal"), at_once)
    pedal.plug()
    clock.sleep(retried)
    assert pedal.process.log_path.read_text().count("is open") == 2
    assert newest() == (False, True, "pedal")
    assert rospy.ServiceProxy("leap_kuka/set_clutch", SetBool)(False).success
    becomes((False, False, ""), debounced)
    refused = rospy.ServiceProxy("leap_kuka/set_enable", SetBool)(True)
    assert not refused.success and "needs the pedal" in refused.message
    clock.sleep(0.2)
    assert newest() == (False, False, "")
    assert len({message.header.stamp for message in inputs}) == len(inputs)
    pedal.process.send_signal(signal.SIGINT)
    assert pedal.process.wait(1.0) == 0


def test_the_tool_starts_where_it_is_and_the_pedal_and_the_service_clutch(ros, node, pedal, tracker, hand):
    states = ros.record("leap_kuka/state", TeleopState)
    T_home = pose(np.diag([-1.0, 1.0, -1.0]), (0.52, 0.01, 0.39))
    flange = T_home @ inverse(pose(p=(0.0, 0.0, 0.106)))
    broadcast = rospy.Publisher("/tf", TFMessage, queue_size=10)
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    control = {"control_on": False, "mode": "home", "scaling_factor": 0.5}

    def arm():
        now = rospy.Time.now()
        broadcast.publish([stamped_transform(flange, "kuka/base_frame", "kuka/flange_frame/measured", now)])
        status.publish(KukaStatus(**control))

    def becomes(state, within):
        assert took(ros, lambda: states[-1].state == state, state) <= within
        clock.sleep(DELAY_S)  # tf may come after it

    repeat(arm, 0.05, "arm")
    node.run()
    clutch = rospy.ServiceProxy("leap_kuka/set_clutch", SetBool)
    clock.sleep(1.0)
    control["control_on"] = True
    pedal.write(("KEY_B", 1), ("KEY_B", 0))
    for z in (0.3, 0.0):
        tracker.show(hand(yaw=20.0, pitch=10.0, position=(0.05, 0.35, z)))
        clock.sleep(1.0)
    unmet = [name for name, met in zip(states[-1].conditions, states[-1].fulfilled) if not met]
    assert (states[-1].state, unmet, node.desired()) == ("waiting", ["enabled"], None)
    pedal.write(("KEY_F13", 1))
    becomes("running", 0.1)
    assert states[-1].enabled and states[-1].engagement == "relative"
    T_base_virtual, T_virtual_tool = node.desired()
    p = (T_base_virtual @ T_virtual_tool)[:3, 3]
    np.testing.assert_allclose([0.5, 0.0, 0.4] + 0.5 * (p - [0.5, 0.0, 0.4]), T_home[:3, 3], atol=1e-6)
    control["mode"] = "servo"
    clock.sleep(0.1)
    assert clutch(True).success
    becomes("clutched", PERIOD_S + 2.0 * DELAY_S)
    assert states[-1].hold_left == RELATIVE["hold_time"]
    assert clutch(False).success
    becomes("running", 0.02 + PERIOD_S + 0.02)
    pedal.unplug()
    becomes("clutched", PERIOD_S + 2.0 * DELAY_S)
    assert not states[-1].enabled
    control["control_on"] = False
    becomes("waiting", 0.05 + PERIOD_S + 2.0 * DELAY_S)


class Policy:
    """A program that lets the tool rise slowly: chunks of 1 s, five times a second."""

    def __init__(self, T_start):
        self._publisher = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
        self.T = T_start
        self.speed = 0.02  # m/s
        self.fingers = []
        self.runs = True
        repeat(self._publish, 0.2, "policy")

    def _publish(self):
        if not self.runs:
            return
        steps = [self.T @ pose(p=(0.0, 0.0, -0.1 * self.speed * i)) for i in range(10)]
        message = PolicyActions(period=0.1, tool=[message_from_pose(T) for T in steps], fingers=self.fingers * 10)
        message.header.stamp, message.header.frame_id = rospy.Time.now(), "kuka/base_frame"
        self._publisher.publish(message)
        self.T = steps[2]


def test_a_policy_steers_until_a_hand_comes_in_and_goes_on_when_it_has_left(ros, node, tracker, hand):
    set_params({"engagement": "relative", "hold_time": 30.0})
    states = ros.record("leap_kuka/state", TeleopState)
    T_home = pose(np.diag([-1.0, 1.0, -1.0]), (0.5, 0.0, 0.4))
    flange = T_home @ inverse(pose(p=(0.0, 0.0, 0.106)))
    broadcast = rospy.Publisher("/tf", TFMessage, queue_size=10)
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    control = {"control_on": True, "mode": "home", "scaling_factor": 1.0}

    def arm():
        now = rospy.Time.now()
        broadcast.publish([stamped_transform(flange, "kuka/base_frame", "kuka/flange_frame/measured", now)])
        status.publish(KukaStatus(**control))

    def tool():
        T_base_virtual, T_virtual_tool = node.desired()
        return T_base_virtual @ T_virtual_tool

    repeat(arm, 0.05, "arm")
    node.run()
    policy = Policy(T_home)
    run = rospy.ServiceProxy("leap_kuka/run_policy", SetBool)
    clock.sleep(1.0)
    assert states[-1].hold == "none" and node.desired() is None, "nobody has said that it may"
    policy.T = T_home
    assert run(True).success
    clock.sleep(0.3)
    control["mode"] = "servo"
    clock.sleep(2.0)
    assert (states[-1].state, states[-1].hold, states[-1].reason_codes) == ("holding", "led", ["led"])
    rise = tool()[2, 3] - 0.4
    assert 0.02 < rise <= 0.05
    for z in (0.3, 0.0):
        tracker.show(hand(position=(0.05, 0.35, z)))
        clock.sleep(1.0)
    assert states[-1].state == "running" and states[-1].hold == "taken"
    taken = tool()
    wanted = policy.T = taken @ pose(p=(0.0, 0.0, -0.01))
    policy.speed = 0.0
    clock.sleep(1.0)
    np.testing.assert_allclose(tool(), taken, atol=1e-6, err_msg="it asks on, and is not heard")
    tracker.show()
    clock.sleep(2.0)
    assert states[-1].hold == "led"
    np.testing.assert_allclose(tool(), wanted, atol=1e-6)
    heights = [
        (found["leap_motion/virtual_frame"] @ found["kuka/tool_frame/desired"])[2, 3]
        for message in node.tf
        if "kuka/tool_frame/desired"
        in (found := {t.child_frame_id: pose_from_transform(t.transform) for t in message.transforms})
    ]
    assert np.abs(np.diff(heights)).max() <= 3.0 * PERIOD_S * 0.02, "no jump at any change"
    policy.runs = False
    clock.sleep(1.0 + 0.3)
    assert states[-1].hold == "kept" and "the program is silent" in states[-1].reason
    policy.T, policy.runs = tool(), True
    clock.sleep(0.5)
    assert states[-1].hold == "led"
    assert run(False).success
    clock.sleep(0.1)
    stays = tool()
    assert states[-1].hold == "kept" and "the program was stopped" in states[-1].reason
    clock.sleep(1.0)
    np.testing.assert_allclose(tool(), stays, atol=1e-9)


def test_each_action_of_a_program_holds_at_its_time(ros):
    heard, period = PolicyInput(PolicyActions, "kuka/base_frame", 4), 0.1
    publisher = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
    message = PolicyActions(period=period, tool=[message_from_pose(pose(p=(0.1 * i, 0.0, 0.4))) for i in range(5)])
    message.header.frame_id = "kuka/base_frame"
    clock.sleep(0.1)
    message.header.stamp = rospy.Time.now() + rospy.Duration.from_sec(period)
    publisher.publish(message)
    for i in range(5):
        clock.sleep(period)
        assert heard.now.T_base_tool[0, 3] == pytest.approx(0.1 * i, abs=1e-4)
    clock.sleep(1.1 * period)
    assert heard.now is None


def test_of_two_programs_at_once_the_first_is_heard(ros):
    heard = PolicyInput(PolicyActions, "kuka/base_frame", 4)

    def program(x):
        rospy.init_node(f"policy_{round(10 * x)}")
        publisher = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
        clock.sleep(x)
        for _ in range(10):
            message = PolicyActions(period=0.1, tool=[message_from_pose(pose(p=(x, 0.0, 0.4)))])
            message.header.stamp, message.header.frame_id = rospy.Time.now(), "kuka/base_frame"
            publisher.publish(message)
            clock.sleep(0.05)

    first, second = (ros.start("policy", lambda x=x: program(x)) for x in (0.2, 0.5))
    seen = []
    while first.poll() is None or second.poll() is None:
        clock.sleep(0.01)
        seen += [] if heard.now is None else [heard.now.T_base_tool[0, 3]]
    assert set(seen) == {0.2, 0.5} and seen == sorted(seen), "the second one once the first one has ended"


def test_of_an_absolute_engagement_no_policy_steers_and_the_service_says_so(ros, node, tracker):
    set_params({})
    node.run()
    clock.sleep(1.0)
    answer = rospy.ServiceProxy("leap_kuka/run_policy", SetBool)(True)
    assert not answer.success and answer.message == (
        "The policy's actions do not count: a program needs leap/engagement relative, and a leap/hold_time above 0."
    )


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"period": 0.0}, "its period is 0 s"),
        ({"fingers": [0.0] * 7}, "they have 7 finger commands"),
        ({"frame": "camera_link"}, "their frame is 'camera_link'"),
        ({"z": float("nan")}, "is not finite"),
        ({"z": 0.9}, "its pose is 500 mm"),
        ({"age": 30.0}, "after its end"),
    ],
)
def test_bad_actions_of_a_policy_are_named_and_move_nothing(ros, node, tracker, changes, sentence):
    set_params({"engagement": "relative", "hold_time": 30.0})
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    broadcast = rospy.Publisher("/tf", TFMessage, queue_size=10)
    flange = pose(np.diag([-1.0, 1.0, -1.0]), (0.5, 0.0, 0.506))

    def arm():
        now = rospy.Time.now()
        broadcast.publish([stamped_transform(flange, "kuka/base_frame", "kuka/flange_frame/measured", now)])
        status.publish(KukaStatus(control_on=True, mode="home", scaling_factor=1.0))

    repeat(arm, 0.05, "arm")
    process = node.run()
    publisher = rospy.Publisher("leap_kuka/policy_actions", PolicyActions, queue_size=1)
    clock.sleep(1.0)
    assert rospy.ServiceProxy("leap_kuka/run_policy", SetBool)(True).success
    clock.sleep(1.0)
    tool = message_from_pose(pose(np.diag([-1.0, 1.0, -1.0]), (0.5, 0.0, 0.4)))
    tool.position.z = changes.get("z", 0.4)
    message = PolicyActions(period=changes.get("period", 0.1), tool=[tool], fingers=changes.get("fingers", []))
    message.header.frame_id = changes.get("frame", "kuka/base_frame")
    for _ in range(3):
        message.header.stamp = rospy.Time.now() - rospy.Duration(changes.get("age", 0.0))
        publisher.publish(message)
        clock.sleep(0.05)
    assert node.desired() is None and process.poll() is None
    assert process.log_path.read_text().count(sentence) == 1
