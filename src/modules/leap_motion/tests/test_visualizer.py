"""From the message leap_motion/Human to markers, and the node that does it."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from common import clock
from leap_motion.codec import read_message
from leap_motion.service import wire
from leap_motion.service.hand import KNUCKLES_MM, WRIST_MM, hand_from_joints

pytest.importorskip("rig_msgs.srv")
import rospy
from visualization_msgs.msg import Marker, MarkerArray

from leap_motion.msg import Human
from leap_motion.ros.hand_markers import hand_markers
from leap_motion.ros.human import FrameMessage
from leap_motion.ros.tracking import ReceivedSkeletons
from tools import launched

pytestmark = pytest.mark.ros


SILENT_S, REMIND_S, POLL_S, PERIOD_S = 3.0, 10.0, 0.1, 1.0 / 30.0
"""Of the visualizer."""


def hands(fingers=5):
    """The text of a frame with a right and a left hand, of different confidence; `fingers`: of the right one."""
    rows = np.array([[0.0, 0.0, -25.0 * i] for i in range(-1, 4)])

    def hand(number, side, confidence, right):
        mirror, palm = np.array([1.0 if side == "right" else -1.0, 1.0, 1.0]), np.array([right, 200.0, -30.0])
        joints = palm + (KNUCKLES_MM[:, None] + rows) * mirror
        joints[0, 0] = joints[0, 1]
        return hand_from_joints(number, side, joints, palm + WRIST_MM * mirror, 1.0, confidence)

    text = wire.frame([hand(7, "right", 0.9, 100.0), hand(8, "left", 0.2, -100.0)], rate=100.0).text(5, 12)
    message = json.loads(text)
    message["pointables"] = message["pointables"][5 - fingers :]
    return read_message(json.dumps(message))


def received(got):
    """The bytes of a frame's message as the visualizer reads them."""
    buffer = io.BytesIO()
    rospy.msg.serialize_message(buffer, 0, FrameMessage(got, rospy.Time(12, 34)))
    return ReceivedSkeletons().deserialize(buffer.getvalue()[4:])


def drawn(tracked, details=True):
    return hand_markers(tracked, "leap_hands", rospy.Duration(1), details)


def points(marker):
    return np.array([(p.x, p.y, p.z) for p in marker.points])


def test_all_bones_and_joints_of_both_hands_lie_where_the_tracker_sees_them():
    got = hands()
    markers = drawn(received(got).hands)
    for hand in got.hands:
        of_hand = [marker for marker in markers if marker.ns == hand.side]
        lines, spheres = (next(m for m in of_hand if m.type == kind) for kind in (Marker.LINE_LIST, Marker.SPHERE_LIST))
        ends = [end for finger in hand.fingers for bone in finger.bones for end in (bone.start, bone.end)]
        assert_allclose(points(lines), ends, atol=1e-9)
        joints = [joint for finger in hand.fingers for joint in finger.joints]
        assert_allclose(points(spheres), [*joints, hand.palm], atol=1e-9)
        assert any(m.text == f"{hand.side} hand {hand.id}, confidence {hand.confidence:.2f}" for m in of_hand)
    assert {marker.ns for marker in markers} == {"left", "right"}
    assert {marker.header.frame_id for marker in markers} == {"leap_hands"}
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers), "one replaces another"


def test_the_colour_tells_the_confidence_of_each_hand():
    bones = {m.ns: m.color for m in drawn(received(hands()).hands, details=False) if len(m.points) == 40}
    assert bones["right"].g > bones["right"].r and bones["left"].r > bones["left"].g


def test_a_hand_with_four_fingers_shows_its_palm_alone():
    tracked = received(hands(fingers=4)).hands
    assert {marker.ns for marker in drawn(tracked, details=False)} == {"left"}
    right = [marker for marker in drawn(tracked) if marker.ns == "right"]
    assert sorted(len(marker.points) for marker in right) == [0, 1, 2, 2]


def test_the_node_draws_what_the_driver_sends_while_somebody_looks(ros):
    publisher = rospy.Publisher("leap_motion/leap_device", Human, queue_size=1)
    node = ros.run("leap_motion", "visualizer", "_frame:=/somewhere")
    arrays = []
    clock.sleep(2 * SILENT_S)
    assert publisher.get_num_connections() == 0 and "Nothing" not in node.log_path.read_text()
    looks = rospy.Subscriber("leap_motion/visualization_marker_array", MarkerArray, arrays.append, queue_size=1000)
    said = lambda: node.log_path.read_text().count("Nothing comes on /leap_motion/leap_device")  # noqa: E731
    clock.sleep(SILENT_S)
    assert said() == 0
    clock.sleep(3 * POLL_S)
    assert said() == 1
    clock.sleep(REMIND_S)
    assert said() == 2
    for _ in range(100):
        publisher.publish(FrameMessage(hands(), rospy.Time.now()))
        clock.sleep(0.01)
    assert 0.9 / PERIOD_S <= len(arrays) <= 1.0 / PERIOD_S + 1, "some are left out"
    markers = [marker for array in arrays for marker in array.markers]
    assert {marker.ns for marker in markers} == {"left", "right"}
    assert {marker.header.frame_id for marker in markers} == {"somewhere"}
    looks.unregister()
    clock.sleep(2 * POLL_S)
    assert publisher.get_num_connections() == 0 and node.poll() is None


def test_a_wrong_parameter_ends_it_with_a_sentence(ros):
    node = ros.run("leap_motion", "visualizer.py", "_frame:=[7]")
    assert node.wait(1.0) == 1
    log = node.log_path.read_text()
    assert "~frame is [7]" in log and "Traceback" not in log


@pytest.mark.parametrize(
    ("package", "file", "arguments", "where"),
    [
        ("leap_motion", "visualization.launch", [], None),
        ("leap_kuka", "leap_kuka_debug.launch", ["visualisation:=true"], "leap_motion/virtual_frame"),
    ],
)
def test_launch_files_open_it_with_rviz(package, file, arguments, where):
    assert "/leap_motion_visualizer" in launched.nodes(package, file, *arguments)
    assert launched.parameters(package, file, *arguments).get("/leap_motion_visualizer/frame") == where
