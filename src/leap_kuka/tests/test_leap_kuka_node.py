"""The node leap_kuka_node on a master of its own, with hands made by hand."""

import os
import threading
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
import yaml

from leap_kuka.operator_devices import EV_KEY, EVENT, KEYS

pytestmark = pytest.mark.ros

LAUNCH = sorted((Path(__file__).parents[1] / "launch").glob("*.launch"))
SHIPPED = yaml.safe_load((Path(__file__).parents[1] / "config" / "leap_params.yaml").read_text())
ARM = {"center_line": [1, 0, 0], "z_lower_limit": 0.2, "tool_length": 0.106, "ws_center": [0.5, 0, 0.4]}
TF_ROUNDING_NS = 1
"""A stamp that went through tf2's buffer can come out a nanosecond earlier."""

PARENTS = {
    "leap_motion/virtual_frame": "kuka/base_frame",
    "hand/frame": "leap_motion/virtual_frame",
    "hand/frame/filtered": "leap_motion/virtual_frame",
    "kuka/tool_frame/desired": "leap_motion/virtual_frame",
    "kuka/flange_frame/desired": "leap_motion/virtual_frame",
}
OF_A_HAND = {"hand/frame", "hand/frame/filtered"}


class Tracker:
    """Publishes Human messages at 50 Hz, with the hands that `show` was given last, until it stops."""

    def __init__(self):
        import rospy

        from leap_motion.msg import Human

        self._publisher = rospy.Publisher("leap_motion/leap_device", Human, queue_size=10)
        self._hands = ()
        self._number = 0
        self._stop = threading.Event()
        self.age = 0.0
        self.stamps = set()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def show(self, *hands):
        self._hands = hands

    def stop(self):
        self._stop.set()
        self._thread.join()

    def end(self):
        self.stop()
        self._publisher.unregister()

    def _loop(self):
        import rospy

        from leap_motion.msg import Human

        while not self._stop.wait(0.02):
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
    tracker = Tracker()
    yield tracker
    tracker.end()


@pytest.fixture
def hand(sample):
    """Makes a hand as `sample` does, as (message, is_left)."""
    from geometry_msgs.msg import Point, Vector3

    from leap_motion.msg import Hand

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
    import rospy

    rospy.set_param("leap", {**SHIPPED, **(leap or {})})
    rospy.set_param("kuka", {"robot": "LBR7R800", **ARM, **(arm or {})})


@pytest.fixture
def node(ros):
    """The node with its topics recorded."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from sensor_msgs.msg import TimeReference
    from tf2_msgs.msg import TFMessage
    from visualization_msgs.msg import MarkerArray

    class Node:
        tf = ros.record("/tf", TFMessage)
        stream = ros.record("leap_kuka/stream", DiagnosticStatus)
        markers = ros.record("leap_kuka/interaction_box", MarkerArray)
        diagnostics = ros.record("/diagnostics", DiagnosticArray)
        times = ros.record("rig/stage_times", TimeReference)

        @staticmethod
        def start():
            return ros.run("leap_kuka", "leap_kuka_node.py")

        def states(self):
            return [{v.key: v.value for v in m.values}["state"] for m in self.stream]

        def owners(self):
            values = [{v.key: v.value for v in m.values} for m in self.stream]
            return [(v["hand_id"], v["hand_side"]) for v in values]

        def holds(self):
            return [{v.key: v.value for v in m.values}["hold"] for m in self.stream]

        def children(self):
            return {t.child_frame_id for t in self.tf[-1].transforms} if self.tf else set()

    return Node()


def test_a_hand_is_followed_and_lost(ros, node, tracker, hand, wait_until):
    import rospy
    import tf2_ros

    rests = "out of the box and back in"

    def comes_in(**changes):
        tracker.show(hand(position=(0.0, 0.35, 0.3), **changes))
        wait_until(lambda: "in front of the box" in node.stream[-1].message, 10.0, "the hand in front of the box")
        node.stream.clear()
        tracker.show(hand(**changes))
        wait_until(
            lambda: "running" in node.states() or any(rests in m.message for m in node.stream), 20.0, "the hand inside"
        )
        return "running" in node.states()

    def goes():
        """The hand goes; whether the node sees that: a busy machine may end the stream before, by a pause."""
        tracker.show()
        wait_until(lambda: node.children() == {"leap_motion/virtual_frame"}, 20.0, "the frames of the hand to end")
        wait_until(lambda: node.states()[-1] == "waiting", 5.0, "the end to be announced")
        return any(m.level == 1 and m.message == "right hand 12 was lost" for m in node.stream)

    def comes_in_and_gets_another_number():
        """Whether the stream of hand 13 continues by hand 14, as it does without a pause."""
        wait_until(lambda: comes_in(id=13), 60.0, "the hand that came in")
        assert ("13", "right") in node.owners()
        tracker.show(hand(id=14, position=(0.005, 0.35, 0.0)))
        wait_until(lambda: node.owners()[-1] in (("14", "right"), ("", "")), 10.0, "the same hand with another number")
        return node.owners()[-1] == ("14", "right")

    set_params()
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    node.start()
    wait_until(lambda: node.children() == {"leap_motion/virtual_frame"}, 20.0, "the virtual Leap without a hand")
    wait_until(lambda: node.states()[-1:] == ["waiting"], 5.0, "the state")

    tracker.show(hand(yaw=50.0))
    wait_until(lambda: "kuka/flange_frame/desired" in node.children(), 20.0, "the desired flange")
    message = next(m for m in node.tf if any(t.child_frame_id == "kuka/flange_frame/desired" for t in m.transforms))
    assert {t.child_frame_id: t.header.frame_id for t in message.transforms} == PARENTS
    assert len({t.header.stamp for t in message.transforms}) == 1
    assert message.transforms[0].header.stamp in tracker.stamps

    desired = buffer.lookup_transform("kuka/base_frame", "kuka/tool_frame/desired", rospy.Time(0), rospy.Duration(5.0))
    nearest = min(abs((desired.header.stamp - stamp).to_nsec()) for stamp in tracker.stamps.copy())
    assert nearest <= TF_ROUNDING_NS
    t, q = desired.transform.translation, desired.transform.rotation
    np.testing.assert_allclose([t.x, t.y, t.z], [0.5, 0.0, 0.4], atol=1e-6)
    np.testing.assert_allclose(np.abs([q.x, q.y, q.z, q.w]), [0, 1, 0, 0], atol=1e-6)
    flange = buffer.lookup_transform("kuka/base_frame", "kuka/flange_frame/desired", rospy.Time(0), rospy.Duration(5.0))
    assert flange.transform.translation.z == pytest.approx(0.506, abs=1e-6)

    wait_until(lambda: "running" in node.states(), 5.0, "the stream to be announced")
    followed = node.stream[node.states().index("running")]
    assert followed.level == 0 and "right hand 12 is followed" in followed.message
    wait_until(lambda: node.times, 5.0, "a stage time")
    assert node.times[-1].source == "leap_kuka" and node.times[-1].header.stamp in tracker.stamps

    while not goes():
        wait_until(lambda: comes_in(yaw=50.0), 60.0, "the hand that came in again")
    assert node.owners()[-1] == ("", "") and ("12", "right") in node.owners()
    tracker.show(hand(id=13))
    wait_until(lambda: rests in node.stream[-1].message, 10.0, "the reason of a hand that is found in the box")
    wait_until(comes_in_and_gets_another_number, 60.0, "a stream that lasts")
    assert ("running", ("14", "right")) in zip(node.states(), node.owners())
    listener.unregister()


def test_the_tool_is_held_for_a_hand_while_control_is_on(ros, node, tracker, hand, wait_until):
    import rospy
    import tf2_ros

    from common.poses import pose
    from common.ros.conversions import pose_from_transform, stamped_pose
    from rig_msgs.msg import KukaStatus
    from rig_msgs.srv import HoldTool

    set_params()
    node.start()
    rospy.wait_for_service("leap_kuka/hold_tool", 20.0)
    hold = rospy.ServiceProxy("leap_kuka/hold_tool", HoldTool)
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1, latch=True)
    T = pose(np.diag([-1.0, 1.0, -1.0]), (0.4, 0.1, 0.3))
    tool = stamped_pose(T, "kuka/base_frame", rospy.Time())

    wait_until(lambda: node.children(), 20.0, "frames")
    off = "The tool is not held: control of the arm is off."  # where frames come in
    wait_until(lambda: hold(tool, 30.0).message == off, 10.0, "the refusal")
    wait_until(lambda: status.get_num_connections() > 0, 10.0, "the node to listen")
    status.publish(KukaStatus(control_on=False))
    seen = len(node.tf)
    wait_until(lambda: len(node.tf) > seen + 20, 10.0, "frames meanwhile: the node keeps the newest status alone")
    status.publish(KukaStatus(control_on=True))

    def held():
        if node.holds()[-1:] == ["none"]:  # at first, and where a busy machine lets no frames come for a moment
            tracker.show()
            hold(tool, 120.0)
        return node.holds()[-1:] == ["held"]

    def taken():
        if held():
            tracker.show(hand(yaw=30.0, position=(0.05, 0.3, 0.02)))
        return node.holds()[-1] == "taken"

    wait_until(held, 20.0, "the hold")
    for bad in (
        stamped_pose(T, "camera_link", rospy.Time()),
        stamped_pose(T * np.nan, "kuka/base_frame", rospy.Time()),
    ):
        answer = hold(bad, 30.0)
        assert not answer.success and ("instead of kuka/base_frame" in answer.message or "finite" in answer.message)
    wait_until(
        lambda: held() and node.children() == set(PARENTS) - OF_A_HAND, 20.0, "the frame of the tool that is held"
    )
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)

    def desired():
        return pose_from_transform(
            buffer.lookup_transform(
                "kuka/base_frame", "kuka/tool_frame/desired", rospy.Time(0), rospy.Duration(10.0)
            ).transform
        )

    np.testing.assert_allclose(desired(), T, atol=1e-6)
    wait_until(taken, 20.0, "the hand that takes over")
    np.testing.assert_allclose(desired(), T, atol=1e-6)
    tracker.show()
    wait_until(lambda: node.holds()[-1] == "none", 20.0, "the end of both")
    wait_until(held, 20.0, "another hold")
    status.publish(KukaStatus(control_on=False))
    wait_until(lambda: node.holds()[-1] == "none", 20.0, "the end with control")
    assert "the tool is no longer held: control of the arm is off" in [m.message for m in node.stream]
    assert hold(tool, 0.0).success
    status.unregister()
    listener.unregister()


def test_a_silent_tracker_ends_the_stream_and_nothing_is_sent_again(ros, node, tracker, hand, wait_until):
    set_params()
    tracker.show(hand())
    node.start()
    wait_until(lambda: "running" in node.states(), 20.0, "the stream")
    tracker.stop()
    silent = ("waiting", "no tracking frames come in")
    wait_until(lambda: (node.states()[-1], node.stream[-1].message) == silent, 10.0, "the end of the stream")
    node.diagnostics.clear()
    wait_until(lambda: len(node.diagnostics) >= 2, 10.0, "a second of diagnostics")
    stamps = [message.transforms[0].header.stamp for message in node.tf]
    assert len(set(stamps)) == len(stamps) and set(stamps) <= tracker.stamps
    status = node.diagnostics[-1].status[0]
    values = {v.key: v.value for v in status.values}
    states = node.states()
    starts = sum(before != "running" == after for before, after in zip(["waiting", *states], states))
    assert (status.name, values["state"], int(values["streams"])) == ("leap_kuka", "waiting", starts)


def test_frames_with_old_stamps_are_not_sent_on(ros, node, tracker, hand, wait_until):
    set_params()
    tracker.age = 60.0
    tracker.show(hand())
    node.start()
    wait_until(lambda: node.stream and "s old" in node.stream[-1].message, 20.0, "the reason")
    assert not node.tf


def test_the_box_is_shown_in_the_colour_of_the_state_with_the_reason(ros, node, tracker, hand, wait_until):
    set_params()
    tracker.show(hand(pitch=40.0))
    node.start()
    wait_until(lambda: node.markers and "pitch is 40" in node.markers[-1].markers[1].text, 20.0, "the reason")
    box, text = node.markers[-1].markers
    assert box.header.frame_id == text.header.frame_id == "leap_motion/virtual_frame"
    np.testing.assert_allclose([box.pose.position.x, box.pose.position.y, box.pose.position.z], [0, 0.35, 0])
    corners = np.array([[p.x, p.y, p.z] for p in box.points])
    assert len(corners) == 24, "the box has twelve edges"
    np.testing.assert_allclose(np.linalg.norm(corners[::2] - corners[1::2], axis=1), 0.2)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-0.1] * 3, [0.1] * 3])
    waiting = box.color
    tracker.show(hand())
    wait_until(lambda: node.markers[-1].markers[0].color != waiting, 20.0, "the other colour")
    followed = next(message for message in reversed(node.markers) if message.markers[0].color != waiting)
    assert "is followed" in followed.markers[1].text


def test_the_node_waits_for_the_controller_and_says_so(ros, node, tracker, wait_until):
    import rospy

    set_params()
    rospy.delete_param("kuka/ws_center")
    process = node.start()
    wait_until(lambda: b"/kuka/ws_center" in process.log_path.read_bytes(), 20.0, "the node to say what it waits for")
    assert process.poll() is None and not node.tf
    rospy.set_param("kuka/ws_center", ARM["ws_center"])
    wait_until(lambda: node.tf, 20.0, "the frames")


@pytest.mark.parametrize(
    "leap, arm, words",
    [
        ({"buffer_size": 0}, {}, ["leap/buffer_size is 0"]),
        (
            {"min_confidence": "high", "run_tol_yav": 3},
            {},
            ["leap/min_confidence is 'high'", "leap/run_tol_yav is not"],
        ),
        ({}, {"center_line": [0, 0, 0]}, ["kuka/center_line is the zero vector"]),
        ({"z_clearance": 0.0}, {"ws_center": [0.5, 0, 0.21]}, ["leap/z_clearance"]),
    ],
)
def test_bad_parameters_end_the_node_with_a_sentence(ros, node, leap, arm, words, wait_until):
    set_params(leap, arm)
    process = node.start()
    wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    log = process.log_path.read_text()
    assert process.returncode == 1 and "Traceback" not in log
    assert all(word in log for word in words)
    assert not node.tf


def test_missing_keys_end_the_node(ros, node, wait_until):
    import rospy

    set_params()
    rospy.delete_param("leap/buffer_size")
    process = node.start()
    wait_until(lambda: process.poll() is not None, 20.0, "the node's end")
    assert process.returncode == 1 and "leap/buffer_size is missing" in process.log_path.read_text()


def test_the_debug_launch_file_runs_without_a_controller(ros, node, tracker, hand, wait_until):
    tracker.show(hand(position=(0.0, 0.45, 0.0)))
    ros.launch("leap_kuka", "leap_kuka_debug.launch", driver="false")
    wait_until(lambda: "kuka/tool_frame/desired" in node.children(), 40.0, "the desired tool")


@pytest.mark.parametrize("path", LAUNCH, ids=lambda path: path.name)
def test_every_launch_argument_is_explained(path):
    arguments = ElementTree.parse(path).getroot().findall("arg")
    assert all(a.get("doc") for a in arguments)


def test_an_interrupted_node_ends_by_itself(ros, node, processes, wait_until):
    set_params()
    process = node.start()
    wait_until(lambda: node.stream, 20.0, "the node")
    assert processes.end(process) == 0


RELATIVE = {"engagement": "relative", "hold_time": 60.0, "clutch": "device", "enabling": "device"}


@pytest.fixture
def pedal(ros, tmp_path):
    """Starts the node with a FIFO as its device; `write` sends events, `close` unplugs it."""
    path = tmp_path / "event-kbd"
    os.mkfifo(path)
    keys = {"device": str(path), "enable_key": "KEY_F13", "clutch_key": "KEY_B"}
    set_params({**RELATIVE, "operator_input": keys})

    class Pedal:
        file = os.open(path, os.O_RDWR | os.O_NONBLOCK)

        def write(self, *keys):
            os.write(self.file, b"".join(EVENT.pack(0, 0, EV_KEY, KEYS[key], value) for key, value in keys))

        def close(self):
            os.close(self.file)
            self.file = None

    pedal = Pedal()
    pedal.process = ros.run("leap_kuka", "operator_input_node.py")
    yield pedal
    if pedal.file is not None:
        pedal.close()


@pytest.fixture
def inputs(ros):
    """The messages on leap_kuka/operator_input."""
    from rig_msgs.msg import OperatorInput

    return ros.record("leap_kuka/operator_input", OperatorInput)


def test_a_pedal_is_read_and_unplugged(ros, pedal, inputs, processes, wait_until):
    import rospy
    from std_srvs.srv import SetBool

    def newest():
        return (inputs[-1].enabled, inputs[-1].clutch, inputs[-1].source) if inputs else None

    wait_until(lambda: newest() == (False, True, "pedal"), 20.0, "the clutch that was not used yet")
    pedal.write(("KEY_B", 1), ("KEY_B", 0))
    wait_until(lambda: newest() == (False, False, ""), 10.0, "its release")
    pedal.write(("KEY_F13", 2), ("KEY_F13", 1))
    wait_until(lambda: newest() == (True, False, "pedal"), 10.0, "the press")
    pedal.write(("KEY_B", 1))
    wait_until(lambda: newest() == (True, True, "pedal"), 10.0, "the clutch")
    pedal.close()
    wait_until(lambda: newest() == (False, True, "pedal"), 10.0, "the unplugged device")
    assert rospy.ServiceProxy("leap_kuka/set_clutch", SetBool)(False).success
    wait_until(lambda: newest() == (False, False, ""), 10.0, "the service")
    assert len({message.header.stamp for message in inputs}) == len(inputs)
    assert processes.end(pedal.process) == 0


def test_the_tool_starts_where_it_is_and_stays_at_the_clutch(ros, node, pedal, tracker, hand, wait_until):
    import rospy
    from std_srvs.srv import SetBool
    from tf2_msgs.msg import TFMessage

    from common.poses import inverse, pose
    from common.ros.conversions import pose_from_transform, stamped_transform
    from rig_msgs.msg import KukaStatus, TeleopState

    states = ros.record("leap_kuka/state", TeleopState)
    T_home = pose(np.diag([-1.0, 1.0, -1.0]), (0.55, 0.1, 0.35))
    flange = T_home @ inverse(pose(p=(0.0, 0.0, 0.106)))
    broadcast = rospy.Publisher("/tf", TFMessage, queue_size=10)
    status = rospy.Publisher("kuka/status", KukaStatus, queue_size=1)
    control = {"on": False, "mode": "home"}

    def arm(_):
        now = rospy.Time.now()
        broadcast.publish([stamped_transform(flange, "kuka/base_frame", "kuka/flange_frame/measured", now)])
        status.publish(KukaStatus(control_on=control["on"], mode=control["mode"], scaling_factor=0.5))

    def found_desired():
        for message in reversed(node.tf[:]):
            found = {t.child_frame_id: pose_from_transform(t.transform) for t in message.transforms}
            if set(found) >= set(PARENTS) - OF_A_HAND:
                T = found["leap_motion/virtual_frame"] @ found["kuka/tool_frame/desired"]
                T[:3, 3] = [0.5, 0.0, 0.4] + 0.5 * (T[:3, 3] - [0.5, 0.0, 0.4])
                return T
        return None

    def frames():
        return sum(t.child_frame_id == "leap_motion/virtual_frame" for m in node.tf[:] for t in m.transforms)

    def state():
        return states[-1].state if states else ""

    def unmet(message):
        return [name for name, met in zip(message.conditions, message.fulfilled) if not met]

    def lasts(wanted):
        """Whether a state comes before the stream ends, as it does where a busy machine lets no frames come."""
        wait_until(lambda: state() in (wanted, "waiting"), 20.0, wanted)
        return state() == wanted

    def walk():
        """Engages, presses the clutch, moves the hand and releases the clutch; whether the stream lasted so long."""
        assert clutch(False).success
        control["mode"] = "home"
        tracker.show(hand(yaw=20.0, pitch=10.0, position=(0.05, 0.35, 0.3)))
        wait_until(lambda: state() == "waiting" and "in the box" in unmet(states[-1]), 20.0, "the hand outside")
        pedal.write(("KEY_F13", 0))  # each stream asks for a press of its own
        wait_until(lambda: not states[-1].enabled, 10.0, "the release")
        pedal.write(("KEY_F13", 1))
        wait_until(lambda: states[-1].enabled, 10.0, "the press")
        node.tf.clear()
        tracker.show(hand(yaw=20.0, pitch=10.0, position=(0.05, 0.35, 0.0)))
        wait_until(lambda: found_desired() is not None, 20.0, "the stream")
        np.testing.assert_allclose(found_desired(), T_home, atol=1e-6)
        wait_until(lambda: "running" in [s.state for s in states], 10.0, "the state of the stream")
        first = next(s for s in reversed(states) if s.state == "running")
        assert first.enabled and first.hand_side == "right" and first.engagement == "relative"
        control["mode"] = "servo"
        assert clutch(True).success
        if not lasts("clutched"):
            return False
        node.tf.clear()
        tracker.show(hand(pitch=40.0, position=(0.06, 0.35, 0.01)))
        settled = time.monotonic() + 2.0
        wait_until(lambda: time.monotonic() > settled, 10.0, "the filter of the hand to settle")
        newest, kept = states[-1], found_desired()
        if newest.state != "clutched":
            return False
        assert newest.hold_left == RELATIVE["hold_time"]
        np.testing.assert_allclose(kept, T_home, atol=1e-6)
        node.tf.clear()
        assert clutch(False).success
        if not lasts("running"):
            return False
        wait_until(lambda: found_desired() is not None or state() == "waiting", 10.0, "a desired tool")
        if not lasts("running"):
            return False
        np.testing.assert_allclose(found_desired(), T_home, atol=2e-3)  # the filter of the hand still settles
        return True

    timer = rospy.Timer(rospy.Duration(0.05), arm)
    process = node.start()
    clutch = rospy.ServiceProxy("leap_kuka/set_clutch", SetBool)
    try:
        wait_until(lambda: state() == "waiting", 20.0, "the state")
        wait_until(lambda: status.get_num_connections() > 0, 20.0, "the node that listens to the arm")
        node.tf.clear()
        wait_until(lambda: frames() > 50, 20.0, "frames, and meanwhile a status with control off")
        control["on"] = True
        pedal.write(("KEY_B", 1), ("KEY_B", 0))
        tracker.show(hand(yaw=20.0, pitch=10.0, position=(0.05, 0.35, 0.0)))
        wait_until(lambda: states[-1].reason.endswith("the enabling device is not pressed"), 20.0, "the reason")
        wait_until(lambda: unmet(states[-1]) == ["enabled"], 10.0, "the enabling device as the only open condition")
        wait_until(walk, 60.0, "a stream that lasts")
        pedal.close()
        wait_until(lambda: state() in ("clutched", "waiting") and not states[-1].enabled, 10.0, "the lost device")
        control["on"] = False
        wait_until(lambda: state() == "waiting", 10.0, "the end with control")
    finally:
        timer.shutdown()
        broadcast.unregister()
        status.unregister()
    assert process.poll() is None
