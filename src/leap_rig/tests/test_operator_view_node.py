"""The node operator_view: what it shows to those who look, what it hears only then, and its silence without a card."""

import signal
import subprocess

import numpy as np
import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from common.ros.node import repeat
from leap_motion.frames import LeapFinger, LeapFrame, LeapHand
from leap_motion.msg import Human
from leap_motion.ros.human import FrameMessage
from leap_rig.cockpit.cloud import NEARER, thinned
from leap_rig.operator.ros import speaker
from leap_rig.operator.ros.view_node import MOST_POINTS
from reflex_msgs.msg import Finger, Hand
from rig_msgs.msg import KukaStatus, OperatorView, TeleopState

pytestmark = pytest.mark.ros

PERIOD_S, HEARTBEAT_S, DELAY_S = 0.1, 0.5, 0.005


@pytest.fixture
def no_card(monkeypatch):
    """A program `aplay` as on a machine without a sound card; its calls."""
    calls = []

    def run(command, **_):
        calls.append(command)
        raise subprocess.CalledProcessError(1, command, stderr=b"no soundcards found")

    monkeypatch.setattr(speaker.subprocess, "run", run)
    return calls


def skeleton():
    joints = np.linspace((0.0, 0.2, 0.0), (0.0, 0.2, -0.1), 5)
    chains = [joints + np.array([0.02 * i, 0.0, 0.0]) for i in range(5)]
    turns = np.array([np.eye(3)] * 4)
    fingers = [LeapFinger(i, i, chain, turns, chain[4], 0.1, 0.02, True) for i, chain in enumerate(chains)]
    zero, down, forward = np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    hand = LeapHand(
        1, "right", joints[0], down, forward, zero, 1.0, 0.0, 0.0, 1.0, 0.08, zero, 0.05, tuple(fingers), None
    )
    return LeapFrame(7, 1000, 110.0, (hand,))


@pytest.fixture
def rig(ros):
    """Publishes what the node shows twenty times a second; `state` is that of the hand."""
    publishers = [
        rospy.Publisher(name, kind, queue_size=1)
        for name, kind in (
            ("kuka/status", KukaStatus), ("leap_kuka/state", TeleopState), ("/diagnostics", DiagnosticArray),
            ("/reflex_takktile/hand_state", Hand), ("leap_motion/leap_device", Human),
        )
    ]  # fmt: skip

    class Rig:
        state = "waiting"

        def publish(self):
            delay = [KeyValue("hand_to_arm_ms", value) for value in ("unknown", "91")]
            pressed = Finger(contact=[True] + 8 * [False], pressure=[30.0] + 8 * [0.0])
            messages = (
                KukaStatus(mode="servo", reason="follows", limited_by=["joint speed"], round_trip=0.002,
                           robot_server="toolbox"),
                TeleopState(state=self.state, reason="why", conditions=["flat"], fulfilled=[True]),
                DiagnosticArray(status=[DiagnosticStatus(name="x", values=delay)]), Hand(finger=[pressed] * 3),
                FrameMessage(skeleton(), rospy.Time.now()),
            )  # fmt: skip
            for publisher, message in zip(publishers, messages):
                publisher.publish(message)

    rig = Rig()
    repeat(rig.publish, 0.05, "rig")
    return rig


def test_it_shows_what_came_to_those_who_look_and_hears_only_then(ros, rig):
    ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    clock.sleep(2.0)
    assert ros.names("/operator_view")["hears"] == set()
    views, hands, markers = [], [], []
    lookers = [
        rospy.Subscriber(f"operator_view/{name}", kind, messages.append)
        for name, kind, messages in (
            ("rows", OperatorView, views), ("hands", MarkerArray, hands), ("markers", MarkerArray, markers)
        )
    ]  # fmt: skip
    clock.sleep(1.0)

    def texts():
        return {row.name: row.text for row in views[-1].rows}

    expected = {"Hand": "waiting: why", "Arm": "servo: follows", "Limits": "joint speed", "Delay": "hand to arm 91 ms",
                "Grip": "grips", "Link": "round trip 2.0 ms, jitter 0.0 ms; toolbox", "Guard": "-"}  # fmt: skip
    assert expected.items() <= texts().items()
    bones, joints = hands[-1].markers
    assert (len(bones.points), len(joints.points)) == (40, 26)
    assert len(markers[-1].markers) == 7 and "Hand: " in markers[-1].markers[0].text
    views.clear()
    hands.clear()
    clock.sleep(10.0)
    assert len(views) == pytest.approx(10.0 / HEARTBEAT_S, abs=4), "the heartbeat"
    assert len(hands) == pytest.approx(10.0 * 15.0, abs=2), "not each of 200 frames"
    for state in ("running", "waiting"):
        rig.state, changed = state, clock.monotonic()
        ros.wait_until(lambda: texts()["Hand"] == f"{state}: why", 1.0, "the change", poll=0.001)  # noqa: B023
        assert clock.monotonic() - changed <= 0.05 + 2.0 * PERIOD_S + 2.0 * DELAY_S
        clock.sleep(1.0)
    for looker in lookers:
        looker.unregister()
    clock.sleep(PERIOD_S + DELAY_S)
    assert ros.names("/operator_view")["hears"] == set()


def test_while_the_master_hangs_who_looks_sees_what_is_new(ros, rig):
    def look_at_hands():
        rospy.init_node("looker")
        rospy.Subscriber("operator_view/hands", MarkerArray)
        rospy.spin()

    ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    views, looker = ros.record("operator_view/rows", OperatorView), ros.start("looker", look_at_hands)
    clock.sleep(1.0)
    hand = "/leap_motion/leap_device"
    assert hand in ros.names("/operator_view")["hears"]
    ros.master_hangs = True
    looker.send_signal(signal.SIGKILL)
    clock.sleep(1.0)
    rig.state = "running"
    clock.sleep(0.5)
    assert "running: why" in [row.text for row in views[-1].rows]
    ros.master_hangs = False
    clock.sleep(0.5)
    assert hand not in ros.names("/operator_view")["hears"]


def test_the_cloud_is_thinned_and_asked_for_once_a_second(ros):
    points = np.ones((480, 640), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])
    points["rgb"] = 0x00FF8010
    fields = [PointField(name, 4 * i, PointField.FLOAT32, 1) for i, name in enumerate(points.dtype.names)]
    whole = PointCloud2(Header(frame_id="eye"), 480, 640, fields, False, 16, 16 * 640, points.tobytes(), True)
    camera = rospy.Publisher("camera/depth_registered/points", PointCloud2, queue_size=1)
    asked = []

    def publish():
        if camera.get_num_connections():
            asked.append(clock.monotonic())
            camera.publish(whole)

    repeat(publish, 0.03, "camera")
    ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    clock.sleep(2.0)
    assert not asked
    clouds = ros.record("operator_view/cloud", PointCloud2)
    clock.sleep(10.0)
    assert 8 <= len(clouds) <= 10 and len(asked) < 100
    cloud = clouds[-1]
    assert cloud.header.frame_id == "eye" and 10_000 < cloud.width <= MOST_POINTS and cloud.height == 1
    shown, colours = thinned(cloud, MOST_POINTS)
    assert shown[0] == pytest.approx([NEARER**2] * 3) and colours[0].tolist() == [0xFF, 0x80, 0x10]


def test_it_says_once_that_there_is_no_sound(ros, rig, no_card):
    rospy.set_param("operator_view/sounds", True)
    node = ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    for rig.state in ("waiting", "running", "waiting"):
        clock.sleep(1.0)
        assert len(no_card) == 1
    log = node.log_path.read_text()
    assert "no soundcards found" in log and log.count("No sounds") == 1


def test_a_wrong_parameter_ends_it_with_a_sentence(ros):
    rospy.set_param("operator_view/sounds", "loud")
    node = ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    assert node.wait(1.0) == 1
    log = node.log_path.read_text()
    assert "~sounds is 'loud'" in log and "Traceback" not in log
