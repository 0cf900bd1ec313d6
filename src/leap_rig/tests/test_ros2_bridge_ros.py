"""What the bridge takes from ROS 2: desired tool frames and goals, whatever they are."""

import math
import struct

import numpy as np
import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from geometry_msgs.msg import Transform, TransformStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String
from tf2_msgs.msg import TFMessage

from common.frames import TOOL_DESIRED, TOOL_HOME
from common.ros.compressed_images import jpeg_from_image
from common.ros.images import image_message
from kuka_msgs.msg import MoveGoal, MoveResult
from leap_rig.ros2 import channels
from leap_rig.ros2.config import LOCALHOST, Ros2BridgeConfig
from leap_rig.ros2.ros import bridge_node
from leap_rig.ros2.ros.bytes_of import bytes_of
from leap_rig.ros2.ros.desired_door import DesiredDoor
from leap_rig.ros2.ros.move_door import MoveDoor

pytestmark = pytest.mark.ros


def tf_bytes(*children, x=0.1, stamp=None):
    transforms = []
    for child in children:
        transform = TransformStamped(Header(0, stamp or rospy.Time.now(), TOOL_HOME), child, Transform())
        transform.transform.translation.x, transform.transform.rotation.w = x, 1.0
        transforms.append(transform)
    return bytes_of(TFMessage(transforms))


@pytest.fixture
def door(ros):
    """The door with what it publishes and what it refuses."""
    heard = ros.record("/tf", TFMessage)
    refused = []
    door = DesiredDoor([TOOL_DESIRED], refused.append)
    door.heard, door.refused = heard, refused
    clock.sleep(1.0)
    return door


def test_only_the_desired_tool_passes(door):
    door.take("/a", tf_bytes("kuka/link_1", f"/{TOOL_DESIRED}", "left/kuka/tool_frame/desired"))
    door.take("/a", tf_bytes("kuka/base_frame"))
    clock.sleep(0.1)
    ((transform,),) = ([*message.transforms] for message in door.heard)
    assert (transform.child_frame_id, transform.header.frame_id) == (TOOL_DESIRED, TOOL_HOME)
    assert transform.transform.translation.x == 0.1 and door.refused == []


def test_bad_numbers_are_left_to_the_controller(door):
    door.take("/a", tf_bytes(TOOL_DESIRED, x=math.nan, stamp=rospy.Time(1)))
    clock.sleep(0.1)
    assert math.isnan(door.heard[0].transforms[0].transform.translation.x)


def test_of_two_nodes_neither_passes_until_one_is_silent(door):
    door.take("/a", tf_bytes(TOOL_DESIRED))
    door.take("/b", tf_bytes(TOOL_DESIRED))
    door.take("/a", tf_bytes(TOOL_DESIRED))
    assert door.taken == 1
    assert len(door.refused) == 2 and "/a and /b" in door.refused[0]
    clock.sleep(1.1)
    door.take("/b", tf_bytes(TOOL_DESIRED))
    assert door.taken == 2


def wild_stamp():
    data = bytearray(tf_bytes(TOOL_DESIRED))
    struct.pack_into("<I", data, 12, 4 * 10**9)
    return bytes(data)


@pytest.mark.parametrize("data", [b"", b"\xff" * 40, None, "torn", "wild"])
def test_what_is_no_message_is_refused(door, data):
    made = {None: lambda: struct.pack("<I", 10**6), "torn": lambda: tf_bytes(TOOL_DESIRED)[:-1], "wild": wild_stamp}
    door.take("/a", data if isinstance(data, bytes) else made[data]())
    clock.sleep(0.1)
    assert len(door.refused) == 1 and not door.heard


def test_a_static_one_is_refused(door):
    door.take_static("/a", tf_bytes(TOOL_DESIRED))
    door.take_static("/a", tf_bytes("kuka/link_1"))
    assert len(door.refused) == 1 and door.taken == 0


def results(sent):
    """Returns number, state and result of each goal that has ended."""
    found = []
    for channel, number, body in sent:
        assert channel == channels.RESULT
        found.append((number, body[0], MoveResult().deserialize(body[1:])))
    return found


@pytest.mark.parametrize("data", [b"", b"\xff" * 300, bytes_of(MoveGoal())])
def test_a_goal_that_nobody_can_take_ends_with_a_sentence(ros, data):
    sent = []
    move = MoveDoor("kuka/move", lambda *frame: sent.append(frame))
    move.start(7, data)
    ((number, state, result),) = results(sent)
    assert (number, state, result.success) == (7, channels.ABORTED, False) and result.message
    move.cancel(7)
    move.look()
    move.close()
    assert len(sent) == 1


def test_images_become_jpeg(ros):
    cv2 = pytest.importorskip("cv2")
    image = np.zeros((24, 32, 3), np.uint8)
    image[..., 0] = 200
    message = jpeg_from_image(image_message(image, "rgb8", "camera", rospy.Time(3)), 90)
    decoded = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(decoded[..., ::-1].astype(int) - image).max() < 10
    assert message.header.stamp == rospy.Time(3) and message.format == "rgb8; jpeg compressed bgr8"
    with pytest.raises(ValueError):
        jpeg_from_image(image_message(image[..., 0], "mono8", "camera", rospy.Time(3)), 90)


class Side:
    """A ROS 2 side that says nothing."""

    def __init__(self, config, request):
        self.closed = False
        self.put = lambda *frame: None

    def receive(self, size):
        assert self.closed, "it would be listened to for ever"
        return b""

    def close(self):
        self.closed = True

    def wait(self):
        return 0


def test_a_bridge_that_is_shut_down_while_it_starts_ends(ros, monkeypatch):
    monkeypatch.setattr(bridge_node, "Ros2Side", Side)
    bridge = bridge_node.Ros2Bridge(Ros2BridgeConfig((), LOCALHOST, False, 10.0, 80, ""))
    monkeypatch.setattr(rospy, "is_shutdown", lambda: True)
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: True)
    bridge.run()


def test_a_topic_of_another_type_is_left_out_with_both_names(ros, monkeypatch):
    monkeypatch.setattr(bridge_node, "Ros2Side", Side)
    bridge = bridge_node.Ros2Bridge(Ros2BridgeConfig((), LOCALHOST, False, 10.0, 80, ""))
    channel, sent, said = bridge._channels["joint_states"], [], []
    monkeypatch.setattr(bridge, "_put", lambda *what: sent.append(what))
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: said.append(text % values))
    for kind, md5sum in (
        ("std_msgs/String", String._md5sum), ("sensor_msgs/JointState", "0" * 32),
        ("sensor_msgs/JointState", JointState._md5sum),
    ):  # fmt: skip
        message = rospy.AnyMsg()
        message._connection_header = {"callerid": "/other", "type": kind, "md5sum": md5sum}
        for _ in range(2):
            bridge._bytes(channel, message)
    assert len(sent) == 2
    assert said == [
        "/other publishes std_msgs/String on joint_states, not sensor_msgs/JointState; it is left out.",
        "/other publishes sensor_msgs/JointState of another definition on joint_states, not sensor_msgs/JointState; "
        "it is left out.",
    ]
