"""The nodes: images in, detections, tf and drawings out; how they wait and how they exit."""

import signal

import cv2
import numpy as np
import pytest
import yaml
from tag_renderer import render

from common import clock
from common.poses import pose
from common.rotations import rotation_about

pytest.importorskip("rig_msgs.srv")
import roslib.packages
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Empty
from tf2_msgs.msg import TFMessage

from apriltag_ros.msg import AprilTagDetectionArray
from apriltag_ros.srv import AnalyzeSingleImage
from common.ros.conversions import pose_from_transform
from common.ros.images import array_from_image, camera_info_message, image_message

pytestmark = pytest.mark.ros

NODE = "apriltag_ros_continuous_node"
TRUTH = pose(rotation_about(0, np.radians(155.0)), (0.02, 0.01, 0.6))


class Camera:
    """Publishes one image again and again, with a new stamp each time."""

    def __init__(self, model, image, encoding="mono8"):
        self.image, self.encoding, self._model = image, encoding, model
        self.edit = lambda message: True  # of each message; whether it is sent
        self.last = rospy.Time(0)  # stamp of the newest image
        self._images = rospy.Publisher("camera_rect/image_raw", Image, queue_size=1)
        self._infos = rospy.Publisher("camera_rect/camera_info", CameraInfo, queue_size=1)
        self._ended = clock.Event()
        clock.Thread(target=self._loop, daemon=True).start()

    def _loop(self):
        while not self._ended.wait(0.05):
            self.last = rospy.Time.now()
            info = camera_info_message(self._model, "camera_optical", self.last)
            image = image_message(self.image, self.encoding, "camera_optical", self.last)
            for publisher, message in ((self._infos, info), (self._images, image)):
                if self.edit(message):
                    publisher.publish(message)

    def close(self):
        self._ended.set()


@pytest.fixture
def images(camera, ros):
    return Camera(camera, render(camera, TRUTH, [(0, 0.1, 0.0, 0.0)], 0.13))


@pytest.fixture
def tags(tmp_path):
    path = tmp_path / "tags.yaml"
    path.write_text(yaml.safe_dump({"standalone_tags": [{"id": 0, "size": 0.1, "name": "tag_frame"}]}))
    return path


@pytest.fixture
def arrays(ros):
    return ros.record("tag_detections", AprilTagDetectionArray)


def launch(ros, tags, **args):
    raw = {"image_topic": "image_raw", "rectified": "false"}
    launched = ros.launch("apriltag_ros", "continuous_detection.launch", tags=tags, **raw, **args)
    clock.sleep(0.17)
    return launched.nodes[0]


def status(ros):
    """Returns a function that gives the level, the message and the number of images of the node's last status."""
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read():
        (last,) = arrays[-1].status
        return last.level, last.message, int({v.key: v.value for v in last.values}["pictures"])

    return read


def test_detections_tf_and_drawing(ros, images, tags, arrays):
    transforms = ros.record("tf", TFMessage)
    drawings = ros.record("tag_detections_image", Image)
    launch(ros, tags)
    clock.sleep(0.2)
    assert arrays[-1].header.stamp == images.last
    assert all(0.04 < (b.header.stamp - a.header.stamp).to_sec() < 0.06 for a, b in zip(arrays, arrays[1:]))
    (detection,) = arrays[-1].detections
    assert (list(detection.id), list(detection.size)) == ([0], [0.1])
    assert arrays[-1].header.frame_id == detection.pose.header.frame_id == "camera_optical"
    p = detection.pose.pose.pose.position
    np.testing.assert_allclose([p.x, p.y, p.z], TRUTH[:3, 3], atol=0.002)
    covariance = np.reshape(detection.pose.pose.covariance, (6, 6))
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-9)
    (transform,) = transforms[-1].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("camera_optical", "tag_frame")
    np.testing.assert_allclose(pose_from_transform(transform.transform), TRUTH, atol=0.02)
    drawing = array_from_image(drawings[-1])
    assert np.any(np.all(drawing == (0, 0, 255), axis=2)), "no red edge"


def changed(kind, **values):
    """An edit of the messages of a kind: other values, False for those that do not come."""

    def edit(message):
        if message._type != f"sensor_msgs/{kind}":
            return True
        for key, value in values.items():
            setattr(message, key, value)
        return bool(values)

    return edit


def in_frame(message):
    message.header.frame_id = f"/{message.header.frame_id}"
    return True


def test_every_image_gets_an_answer_and_so_does_what_image_geometry_takes(ros, images, tags, arrays):
    launch(ros, tags)
    for edit in (
        changed("CameraInfo", R=[0.0] * 9),
        changed("CameraInfo", P=[0.0] * 12),
        changed("CameraInfo", width=0, height=0),
        in_frame,
    ):
        images.edit = edit
        clock.sleep(0.1)
        assert arrays[-1].header.stamp == images.last and arrays[-1].header.frame_id == "camera_optical"
        assert arrays[-1].detections[0].pose.pose.pose.position.z == pytest.approx(0.6, abs=0.002)
    grey = images.image
    for encoding, channels in (("rgb8", 3), ("bgr8", 3), ("rgba8", 4), ("bgra8", 4)):
        images.image, images.encoding = np.dstack([grey] * channels), encoding
        clock.sleep(0.1)
        assert arrays[-1].header.stamp == images.last and arrays[-1].detections
    images.image, images.encoding = np.full_like(grey, 90), "mono8"
    clock.sleep(0.1)
    assert arrays[-1].header.stamp == images.last and not arrays[-1].detections


REFUSED = [
    (changed("CameraInfo"), "Nothing has come on /camera_rect/camera_info."),
    (changed("Image", encoding="16UC1", width=320), "the image has the encoding 16UC1"),
    (changed("CameraInfo", width=320), "the image is 640 x 480, but its camera_info says 320 x 480"),
]


@pytest.mark.parametrize(("edit", "reason"), REFUSED)
def test_the_first_thing_that_is_wrong_is_said_from_the_start_and_later(ros, images, tags, arrays, edit, reason):
    last, good = status(ros), images.edit
    images.edit = edit
    node = launch(ros, tags)
    for _ in range(2):
        clock.sleep(2.1)
        level, sentence, _ = last()
        assert level == DiagnosticStatus.WARN and reason[1:] in sentence
        log, before = node.log_path.read_text(), len(arrays)
        assert reason[1:].rstrip(".") in log and "Traceback" not in log
        images.edit = good
        clock.sleep(1.1)
        assert last()[:2] == (DiagnosticStatus.OK, "Detects.") and len(arrays) > before
        if "camera_info." in reason:
            return  # what came once is known
        images.edit = edit


def test_of_rectified_images_the_distortion_does_not_matter(ros, camera, tags, arrays):
    images = Camera(camera.rectified(), render(camera.rectified(), TRUTH, [(0, 0.1, 0.0, 0.0)], 0.13))
    images.edit = changed("CameraInfo", K=[0.0] * 9, D=[0.1] * 4, distortion_model="equidistant")
    ros.launch("apriltag_ros", "continuous_detection.launch", tags=tags, image_topic="image_raw")
    clock.sleep(0.32)
    assert arrays[-1].header.stamp == images.last and arrays[-1].detections


def test_parameters_are_read_anew_on_demand_and_kept_when_wrong(ros, images, tags, arrays):
    launch(ros, tags)
    refresh = rospy.ServiceProxy(f"{NODE}/refresh_tag_params", Empty)
    rospy.set_param(f"{NODE}/standalone_tags", [{"id": 0, "size": -1.0}])
    with pytest.raises(rospy.ServiceException, match="old parameters"):
        refresh()
    clock.sleep(0.1)
    assert arrays[-1].header.stamp == images.last and arrays[-1].detections[0].size == (0.1,)
    rospy.set_param(f"{NODE}/standalone_tags", [{"id": 0, "size": 0.2, "name": "twice"}])
    refresh()
    clock.sleep(0.1)
    assert arrays[-1].detections[0].size == (0.2,)


def test_it_waits_for_the_camera_says_when_that_falls_silent_and_an_interrupt_stops_it(ros, camera, tags):
    last = status(ros)
    node = launch(ros, tags)
    clock.sleep(0.5)
    waits = "Nothing has come on /camera_rect/image_raw, /camera_rect/camera_info."
    assert last() == (DiagnosticStatus.WARN, waits, 0)
    images = Camera(camera, np.full((480, 640), 90, np.uint8))
    clock.sleep(1.0)
    assert last()[:2] == (DiagnosticStatus.OK, "Detects.") and last()[2] > 10
    images.close()
    clock.sleep(0.9)
    assert last()[:2] == (DiagnosticStatus.OK, "Detects.")
    clock.sleep(0.7)
    assert last()[0] == DiagnosticStatus.WARN
    assert last()[1].startswith("Nothing has come on /camera_rect/image_raw for 1.")
    node.send_signal(signal.SIGINT)
    assert node.wait(1.0) == 0
    assert "Traceback" not in node.log_path.read_text()


@pytest.mark.parametrize("name", [NODE, "apriltag_ros_single_image_server_node"])
def test_launch_files_for_the_published_package_find_the_nodes(ros, name):
    """Its programs have no suffix."""
    assert roslib.packages.find_node("apriltag_ros", name)
    node = ros.run("apriltag_ros", name)
    assert node.wait(1.0) == 1
    assert "standalone_tags and tag_bundles are both empty" in node.log_path.read_text()


def test_single_image(ros, camera, tmp_path):
    image, goal = tmp_path / "in.png", tmp_path / "out.png"
    cv2.imwrite(str(image), render(camera.rectified(), TRUTH, [(0, 0.1, 0.0, 0.0)], 0.13))
    node = ros.run("apriltag_ros", "apriltag_ros_single_image_server_node.py", "_standalone_tags:=[{id: 0, size: 0.1}]")
    rospy.wait_for_service("single_image_tag_detection", 1.0)
    analyse = rospy.ServiceProxy("single_image_tag_detection", AnalyzeSingleImage)
    info = camera_info_message(camera, "camera_optical", rospy.Time.now())
    (detection,) = analyse(str(image), str(goal), info).tag_detections.detections
    assert detection.pose.pose.pose.position.z == pytest.approx(0.6, abs=0.002)
    assert cv2.imread(str(goal)).shape == (480, 640, 3)
    info.header.frame_id, info.width, info.height = "/camera_optical", 0, 0
    assert analyse(str(image), "", info).tag_detections.header.frame_id == "camera_optical"
    other = camera_info_message(camera, "camera_optical", rospy.Time.now())
    other.width = 320
    with pytest.raises(rospy.ServiceException, match="640 x 480, but its camera_info says 320 x 480"):
        analyse(str(image), "", other)
    for source, save, sentence in (
        (str(tmp_path / "none.png"), "", "Cannot read"),
        (str(image), str(tmp_path / "no" / "folder.png"), "Cannot save"),
        (str(image), str(tmp_path / "no.format"), "was not analysed"),
    ):
        with pytest.raises(rospy.ServiceException, match=sentence):
            analyse(source, save, info)
    assert node.poll() is None
