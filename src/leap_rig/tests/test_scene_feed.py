"""What the cockpit's scene is fed: only while somebody looks, and whatever nodes publish."""

import math

import numpy as np
import pytest

from common import clock

pytest.importorskip("rig_msgs.msg")
import rospy
from geometry_msgs.msg import Point, Quaternion, Transform, TransformStamped, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from leap_rig.cockpit.ros.scene_feed import CLOUD, SceneFeed
from rig_msgs.msg import SentGoals

pytestmark = pytest.mark.ros


class Shown:
    """A scene that records the calls."""

    def __init__(self):
        self.axes, self.transforms, self.drawings, self.clouds, self.joints, self.robots = [], {}, {}, [], {}, {}

    def show_axes(self, frame, length_m, name=""):
        self.axes.append(frame)

    def put_transform(self, parent, child, numbers, now):
        self.transforms[child] = parent, numbers, now

    def set_robot(self, arm, urdf, read_mesh):
        self.robots[arm] = urdf

    def set_commanded(self, arm, joints):
        self.joints[arm] = list(joints)

    def set_drawings(self, group, drawings):
        self.drawings[group] = dict(drawings)

    def set_cloud(self, frame, points, colours):
        self.clouds.append((frame, points))

    def update(self, now):
        pass

    def together(self):
        return clock.Lock()


@pytest.fixture
def shown(virtual_graph):
    shown = Shown()
    shown.feed = SceneFeed(shown, ("left", "right"))
    return shown


def marker(frame="left/kuka/base_frame", **more):
    made = Marker(ns="workspace", type=Marker.CUBE, color=ColorRGBA(1, 1, 1, 1), scale=Vector3(0.1, 0.1, 0.1), **more)
    made.header.frame_id = frame
    return made


def send(topic, message, latch=False):
    publisher = rospy.Publisher(topic, type(message), queue_size=5, latch=latch)
    clock.sleep(0.5)
    publisher.publish(message)
    clock.sleep(0.5)
    return publisher


def cloud():
    fields = [PointField(name, 4 * n, PointField.FLOAT32, 1) for n, name in enumerate(("x", "y", "z"))]
    data = np.ones((5, 3), dtype=np.float32).tobytes()
    message = PointCloud2(fields=fields, height=1, width=5, point_step=12, row_step=60, data=data)
    message.header.frame_id = "/camera_rgb_optical_frame"
    return message


def test_nothing_is_heard_until_somebody_looks_and_after(shown):
    publisher = rospy.Publisher("left/kuka/workspace", MarkerArray, queue_size=1)
    points = rospy.Publisher(CLOUD, PointCloud2, queue_size=1)
    clock.sleep(2.0)
    assert not publisher.get_num_connections() and not points.get_num_connections() and not shown.drawings
    shown.feed.start()
    clock.sleep(1.0)
    assert publisher.get_num_connections() == 1
    shown.feed.stop()
    clock.sleep(1.0)
    assert not publisher.get_num_connections() and not points.get_num_connections()


def test_markers_goals_transforms_and_description_are_passed_on(shown):
    rospy.set_param("right/robot_description", "<robot/>")
    shown.feed.start()
    send("left/kuka/workspace", MarkerArray([marker()]))
    goals = SentGoals(sent=2 * [rospy.Time()], joints=[*range(7), *range(10, 17)], velocity=[0.0, 0.0])
    send("right/kuka/sent_goals", goals)
    transform = TransformStamped(transform=Transform(Vector3(1, 2, 3), Quaternion(0, 0, 0, 1)), child_frame_id="/b")
    transform.header.frame_id = "a"
    send("/tf", TFMessage([transform]))
    send("/tf_static", TFMessage([transform]), latch=True)
    assert list(shown.drawings["left/kuka/workspace"]) == [("workspace", 0)]
    assert shown.joints == {"right": [*range(10, 17)]} and shown.robots == {"right": "<robot/>"}
    assert shown.transforms["b"] == ("a", (1, 2, 3, 0, 0, 0, 1), math.inf)
    assert "left/leap_motion/virtual_frame" in shown.axes


def test_of_a_cloud_that_comes_often_one_a_second_is_read(shown):
    publisher = rospy.Publisher(CLOUD, PointCloud2, queue_size=1)
    shown.feed.start()
    for _ in range(100):
        publisher.publish(cloud())
        clock.sleep(0.1)
    assert 5 <= len(shown.clouds) <= 11
    assert shown.clouds[0][0] == "camera_rgb_optical_frame" and shown.clouds[0][1].shape == (5, 3)


def test_what_cannot_be_drawn_is_said_once_and_the_rest_is_shown(virtual_graph, shown):
    shown.feed.start()
    bad = [marker(id=n, points=[Point(math.nan, 0, 0)]) for n in range(3)]
    send("simulation/objects", MarkerArray([*bad, marker(id=7, points=[])]))
    send("simulation/objects", MarkerArray([*bad, marker(id=8)]))
    broken = cloud()
    broken.data = b"123"
    send(CLOUD, broken)
    assert list(shown.drawings["simulation/objects"]) == [("workspace", 7), ("workspace", 8)]
    assert not shown.clouds


def test_bodies_that_hide_the_robot_are_left_out(shown):
    shown.feed.start()
    body = marker()
    body.ns = "robot"
    send("left/kuka/guard_markers", MarkerArray([body, marker()]))
    assert list(shown.drawings["left/kuka/guard_markers"]) == [("workspace", 0)]
