"""What the operator sees when images come late, torn, without depth, or not at all: the drawing of stereo_view."""

import pytest
from depth_scene import load
from stereo_camera import REMAPS, Camera, middle, status

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from sensor_msgs.msg import Image

from common.ros.diagnostics import Diagnostics
from common.ros.params import private_config
from vision.ros.stereo.eye_images import StereoImageSource
from vision.ros.stereo.view_node import _draw
from vision.stereo.view import StereoViewConfig

pytestmark = pytest.mark.ros


@pytest.fixture
def camera(ros):
    return Camera()


@pytest.fixture
def shown(ros):
    """What is published of the screen."""
    return ros.record("stereo_view/image", Image)


class Window:
    """In place of the window, which needs Qt's event loop."""

    def show_image(self, image):
        pass


class Held:
    """In place of a publisher, keeps the message."""

    def publish(self, message):
        self.message = message


@pytest.fixture
def sentence(ros):
    """Starts the drawing as the node does; returns a function that gives the sentence of its last status."""

    def main():
        rospy.init_node("stereo_view")
        images = StereoImageSource(private_config(StereoViewConfig, "view"))
        images.subscribe(True)
        Diagnostics("stereo_view", images.diagnose)
        _draw(images, Window(), clock.Event())

    rospy.set_param("stereo_view/view", load("stereo_view.yaml"))
    read = status(ros, "stereo_view")
    ros.start("stereo_view", main, "stereo_view", *REMAPS)
    clock.sleep(0.6)
    return read


def publish(camera, seconds, **how):
    """Publishes fifteen images a second as the Xtion does, the first one at once."""
    for _ in range(round(15.0 * seconds)):
        camera.publish(**how)
        clock.sleep(1.0 / 15.0)


def test_both_eyes_see_the_camera_and_the_age_when_it_stops(camera, shown, sentence):
    """After half a second; an old image is drawn again each 0.2 s."""
    assert sentence() == "Nothing has come on /camera/rgb/image_raw, /camera/rgb/camera_info." and not shown
    publish(camera, 1.0)
    assert sentence() == "Shows images."
    assert (shown[-1].width, shown[-1].height, shown[-1].encoding) == (1920, 1080, "rgb8")
    assert len({message.header.stamp for message in shown}) == 15
    clock.sleep(0.42)
    assert middle(shown[-1])[0][0] == 200
    clock.sleep(0.15)
    last = middle(shown[-1])
    assert shown[-1].header.stamp == shown[-2].header.stamp
    for left, right in (last[:2], last[2:]):
        assert left[0] == 80 and left[2] == 0 and right[2] == 80 and right[0] == 0
    clock.sleep(1.0)
    assert sentence().startswith("Nothing has come on /camera/rgb/image_raw for 1.")
    publish(camera, 0.6)
    assert sentence() == "Shows images." and middle(shown[-1])[0][0] == 200


def test_an_image_that_comes_before_its_camera_info_is_shown_once_that_is_there(camera, shown, sentence):
    info = camera.publishers["rgb/camera_info"]
    camera.publishers["rgb/camera_info"] = held = Held()
    camera.publish()
    clock.sleep(0.5)
    assert not shown
    info.publish(held.message)
    clock.sleep(0.1)
    assert shown[-1].header.stamp == held.message.header.stamp


@pytest.mark.parametrize("how", [{"depth": False}, {"gap": 0.17}])
def test_without_depth_of_its_time_it_shows_the_image_twice_and_says_so(camera, sentence, how):
    publish(camera, 0.6, gap=0.03)
    assert sentence() == "Shows images."
    clock.sleep(0.2)  # the depth is old
    publish(camera, 0.6, **how)
    assert sentence() == "Shows the same image twice: no depth of its time on /camera/depth/image_raw."


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"rgb/image_raw": {"encoding": "yuv422"}}, "The colour image has the encoding yuv422"),
        ({"rgb/camera_info": {"width": 320}}, "The image is 640 x 480, but its camera_info says 320 x 480"),
        ({"rgb/camera_info": {"K": [0.0] * 9}}, "The camera is not calibrated"),
        ({"rgb/image_raw": {"stamp": 7}}, "The camera repeats its image: the stamp does not change."),
        ({"depth/image_raw": {"encoding": "64FC1"}}, "Shows the same image twice: the encoding '64FC1' is unknown"),
        ({"depth/image_raw": {"height": 240, "data": bytes(640 * 240 * 2)}}, "640 x 240 pixels instead of 640 x 480"),
        ({"rgb/camera_info": {"width": 0, "height": 0}}, "Shows images."),
    ],
)
def test_the_first_thing_that_is_wrong_is_said(camera, shown, sentence, edit, said):
    camera.edit = edit
    publish(camera, 2.2)
    assert said in sentence()
    flat = "twice" in said or "pixels" in said
    assert (len({message.header.stamp for message in shown}) > 10) == (flat or said == "Shows images.")
    camera.edit = {}
    publish(camera, 1.0)
    assert sentence() == "Shows images."


def test_torn_images_are_not_shown_and_do_not_count_as_new(ros, camera, shown, sentence):
    publish(camera, 0.6)
    before = shown[-1].header.stamp
    for _ in range(22):
        camera.publish_torn()
        clock.sleep(0.1)
    assert "5 bytes instead of" in sentence() and shown[-1].header.stamp == before
    (node,) = (node for node in ros.nodes if node.name == "/stereo_view")
    assert "5 bytes" in node.log_path.read_text()
    publish(camera, 0.6)
    assert sentence() == "Shows images."


def test_without_a_screen_the_node_ends_with_a_sentence(ros, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    rospy.set_param("stereo_view", {"view": load("stereo_view.yaml"), "output": ""})
    node = ros.run("vision", "stereo_view_node.py")
    assert node.wait(1.0) == 1
    assert "there is no screen" in node.log_path.read_text()
