"""The window that shows image topics: what it draws, and that it switches between them."""

from __future__ import annotations

import numpy as np
import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from sensor_msgs.msg import Image
from std_msgs.msg import String

from common.ros.images import image_message
from grasping.ros.image_viewer import ImageViewer, picture
from tools import launched

pytestmark = pytest.mark.ros

SOON_S = 0.1
"""After which an image that is published 20 times a second has come."""


def message(array, encoding):
    return image_message(array, encoding, "camera", rospy.Time(1))


def test_colours_are_shown_red_first_and_grey_as_grey():
    colours = np.random.default_rng(1).integers(0, 256, (4, 6, 3)).astype(np.uint8)
    np.testing.assert_array_equal(picture(message(colours, "rgb8")), colours)
    np.testing.assert_array_equal(picture(message(colours, "bgr8")), colours[..., ::-1])
    clear = np.insert(colours, 3, 255, axis=2)
    np.testing.assert_array_equal(picture(message(clear, "rgba8")), colours)
    np.testing.assert_array_equal(picture(message(clear[..., [2, 1, 0, 3]].copy(), "bgra8")), colours)
    np.testing.assert_array_equal(picture(message(colours[..., 0], "mono8")), np.dstack([colours[..., 0]] * 3))


@pytest.mark.parametrize(("kind", "encoding", "none"), [(np.uint16, "16UC1", 0), (np.float32, "32FC1", np.nan)])
def test_depth_is_brighter_where_it_is_nearer_and_black_where_there_is_none(kind, encoding, none):
    depth = np.tile(np.linspace(600, 900, 60).astype(kind), (40, 1))
    depth[:10] = none
    shown = picture(message(depth, encoding)).astype(int).sum(axis=2)
    assert not shown[:10].any()
    assert np.all(np.diff(shown[20]) <= 0) and shown[20, 0] > shown[20, -1] + 200
    assert not picture(message(np.full((4, 4), none, kind), encoding)).any()


def test_an_image_with_a_sign_is_shown_whole():
    """ggcnn/img/depth has its mean taken off, ggcnn/img/ang is an angle."""
    shown = picture(message(np.tile(np.linspace(-1.0, 1.0, 60, dtype=np.float32), (20, 1)), "32FC1"))
    assert shown.any(axis=2).all() and (shown[10, 10] != shown[10, 25]).any()


@pytest.fixture
def publishers(ros):
    """Three topics, each of one colour, published until the test ends, and one of another type."""
    colours = {"/viewer/red": (200, 0, 0), "/viewer/green": (0, 200, 0)}
    made = {topic: rospy.Publisher(topic, Image, queue_size=1) for topic in (*colours, "/viewer/odd")}
    rospy.Publisher("/viewer/text", String, queue_size=1)

    def publish(_):
        for topic in colours.keys() & made.keys():
            made[topic].publish(message(np.tile(np.uint8(colours[topic]), (30, 40, 1)), "rgb8"))
        odd = message(np.zeros((3, 4), np.uint8), "mono8")
        odd.encoding = "yuv422"
        made["/viewer/odd"].publish(odd)

    rospy.Timer(rospy.Duration(0.05), publish)
    return made


@pytest.fixture
def viewer(application, publishers):
    window = ImageViewer("/viewer/red")
    window.show()
    yield window
    window.close()
    window.deleteLater()


def centre(window):
    pixmap = window.shown.pixmap()
    if pixmap is None or pixmap.isNull():
        return None
    colour = pixmap.toImage().pixelColor(pixmap.width() // 2, pixmap.height() // 2)
    return colour.red(), colour.green(), colour.blue()


def test_the_list_has_the_image_topics_and_a_choice_switches(viewer, publishers):
    def after_a_while():
        clock.sleep(SOON_S)
        viewer.draw()

    after_a_while()
    assert centre(viewer) == (200, 0, 0)
    viewer.list_topics()
    names = [viewer.choice.itemText(i) for i in range(viewer.choice.count())]
    assert {"/viewer/red", "/viewer/green", "/viewer/odd"} <= set(names) and "/viewer/text" not in names
    assert viewer.choice.currentText() == "/viewer/red"
    viewer.choice.setCurrentText("/viewer/green")
    assert centre(viewer) is None, "what was there is of the topic before"
    after_a_while()
    assert centre(viewer) == (0, 200, 0)
    assert publishers["/viewer/red"].get_num_connections() == 0, "the first one is let go"
    viewer.choice.setCurrentText("/viewer/odd")
    after_a_while()
    assert "yuv422" in viewer.text.text()
    clock.sleep(2.0)
    viewer.draw()
    assert "yuv422" in viewer.text.text()
    viewer.choice.setCurrentText("/viewer/red")
    after_a_while()
    assert viewer.text.text() == "40 x 30, rgb8"
    del publishers["/viewer/red"]
    after_a_while()
    clock.sleep(1.2)
    viewer.draw()
    assert viewer.text.text().startswith("nothing has come on /viewer/red for 1.")


def test_the_launch_file_starts_it_with_the_chosen_image():
    assert "/heat_map_view" in launched.nodes("grasping", "grasping.launch", "image_view:=true")
    assert "/heat_map_view" not in launched.nodes("grasping", "grasping.launch", "image_view:=false")
