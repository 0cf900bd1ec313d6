"""The nodes plane_pose and register_rgbd: what they publish, that they ask for nothing unasked, and how they end."""

import threading

import numpy as np
import pytest
from depth_scene import DEPTH, PLATE, RGB, T_RGB_DEPTH, board_pose, depth_image, load
from tag_renderer import render

from common.frames import DEPTH_OPTICAL, RGB_OPTICAL

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

TAGS = [(0, 0.1, 0, 0), *((i, 0.06, x, y) for i, x, y in ((1, -1, 1), (2, 1, 1), (3, -1, -1), (4, 1, -1)))]
TAGS = [(i, size, 0.105 * x, 0.105 * y) for i, size, x, y in TAGS]
TRUTH = board_pose(0.9, 20.0, x=0.03, y=-0.02)


@pytest.fixture(scope="module")
def images():
    grey = render(RGB, TRUTH, TAGS, PLATE)
    return np.stack((grey, grey, grey), axis=-1), np.rint(1000.0 * depth_image(TRUTH)).astype(np.uint16)


class Camera:
    """Publishes a pair of images again and again, with a new stamp each time."""

    def __init__(self, colour, depth):
        import rospy
        import tf2_ros
        from sensor_msgs.msg import CameraInfo, Image

        from common.ros.conversions import stamped_transform

        self.colour, self.depth, self.late, self.sent = colour, depth, 0.0, 0
        self.images = {name: rospy.Publisher(f"camera/{name}/image_raw", Image, queue_size=1) for name in MODELS}
        self._infos = {name: rospy.Publisher(f"camera/{name}/camera_info", CameraInfo, queue_size=1) for name in MODELS}
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._static.sendTransform(stamped_transform(T_RGB_DEPTH, RGB_OPTICAL, DEPTH_OPTICAL, rospy.Time.now()))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def heard_everywhere(self):
        return all(p.get_num_connections() for p in (*self.images.values(), *self._infos.values()))

    def close(self):
        self._ended.set()
        self._thread.join(5.0)
        for publisher in (*self.images.values(), *self._infos.values()):
            publisher.unregister()

    def _loop(self):
        import rospy

        from common.ros.images import camera_info_message, image_message

        while not self._ended.wait(0.1):
            stamp = rospy.Time.now()
            for name, (model, frame) in MODELS.items():
                at = stamp + rospy.Duration(self.late if name == "depth" else 0.0)
                image, encoding = (self.colour, "rgb8") if name == "rgb" else (self.depth, "16UC1")
                self._infos[name].publish(camera_info_message(model, frame, at))
                self.images[name].publish(image_message(image, encoding, frame, at))
            self.sent += 1


MODELS = {"rgb": (RGB, RGB_OPTICAL), "depth": (DEPTH, DEPTH_OPTICAL)}


@pytest.fixture
def camera(ros, images):
    made = Camera(*images)
    yield made
    made.close()


@pytest.fixture
def start(ros):
    """Starts the node plane_pose with the package's parameters and changes to them."""
    import rospy

    def run(**changes):
        values = {
            "detector": {**load("settings.yaml"), **load("tags.yaml")},
            "panel": load("panel.yaml"),
            "plane_pose": load("plane_pose.yaml"),
        }
        for key, value in changes.items():
            section, _, name = key.partition("/")
            (values[section] if name else values).__setitem__(name or section, value)
        rospy.set_param("plane_pose", values)
        remaps = [f"{n}/{t}:=camera/{n}/{t}" for n in MODELS for t in ("image_raw", "camera_info")]
        return ros.run("vision", "plane_pose_node.py", *remaps)

    return run


def diagnostics(ros, name):
    """Returns a function that gives the message and the values of a node's last status."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == name]
        return {"message": found[-1].message, **{v.key: v.value for v in found[-1].values}} if found else {}

    return read


def test_the_board_comes_fused_and_by_its_plane_in_topics_and_tf(ros, camera, start, wait_until):
    import rospy
    import tf2_ros

    from apriltag_ros.msg import AprilTagDetectionArray
    from common.ros.conversions import pose_from_message, pose_from_transform

    arrays = {n: ros.record(f"tag_detections_{n}", AprilTagDetectionArray) for n in ("fused", "plane")}
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    status = diagnostics(ros, "plane_pose")
    start()
    for name, messages in arrays.items():
        message = messages.wait(2, 30.0)[-1]
        (detection,) = message.detections
        assert message.header.frame_id == detection.pose.header.frame_id == RGB_OPTICAL
        assert list(detection.id) == [0, 1, 2, 3, 4]
        np.testing.assert_allclose(pose_from_message(detection.pose.pose.pose), TRUTH, atol=6e-3)
        assert np.linalg.eigvalsh(np.reshape(detection.pose.pose.covariance, (6, 6)))[0] > 0.0
        frame = f"tag_frame/{name}"
        wait_until(lambda frame=frame: buffer.can_transform(RGB_OPTICAL, frame, rospy.Time(0)), 15.0, frame)
        found = buffer.lookup_transform(RGB_OPTICAL, frame, rospy.Time(0)).transform
        np.testing.assert_allclose(pose_from_transform(found), TRUTH, atol=6e-3)
    wait_until(lambda: status().get("message") == "the marker board has a pose with depth", 15.0, "the status")
    assert float(status()["colour_to_fused_mm"]) < 5.0
    listener.unregister()


def test_without_depth_there_is_no_pose_but_a_reason_and_it_comes_back(ros, camera, start, images, wait_until):
    from apriltag_ros.msg import AprilTagDetectionArray

    fused = ros.record("tag_detections_fused", AprilTagDetectionArray)
    status = diagnostics(ros, "plane_pose")
    camera.depth = np.zeros_like(images[1])
    process = start()
    wait_until(lambda: "have a depth near it" in status().get("message", ""), 30.0, "the reason")
    assert not any(message.detections for message in fused)
    assert "No pose with depth" in process.log_path.read_text()
    camera.colour = np.zeros_like(images[0])
    wait_until(lambda: "no tag" in status()["message"], 15.0, "the reason")
    camera.colour, camera.depth = images
    wait_until(lambda: fused and fused[-1].detections, 15.0, "the pose")


def test_what_does_not_belong_together_is_waited_for(ros, camera, start, wait_until):
    status = diagnostics(ros, "plane_pose")
    camera.late = 1000.0
    start()
    wait_until(lambda: status().get("message") == "waits for images", 30.0, "the status")
    camera.late = 0.0
    wait_until(lambda: status().get("message") == "the marker board has a pose with depth", 30.0, "pairs")


@pytest.mark.parametrize(
    ("changes", "faults"),
    [
        ({"panel/frame": "box"}, ("the marker board box",)),
        ({"plane_pose/noise": 0.0, "plane_pose/nose": 1.0}, ("~plane_pose/noise is 0", "~plane_pose/nose")),
        ({"slop": -1.0, "slip": 1.0}, ("~slop is -1", "~slip")),
    ],
)
def test_plane_pose_names_wrong_parameters(ros, start, changes, faults):
    process = start(**changes)
    assert process.wait(60.0) == 1
    log = process.log_path.read_text()
    assert all(fault in log for fault in faults)
    assert "Traceback" not in log


def test_tags_out_of_the_plates_plane_are_refused(ros, start):
    tags = load("tags.yaml")["tag_bundles"]
    tags[0]["layout"][1]["z"] = 0.02
    process = start(**{"detector/tag_bundles": tags})
    assert process.wait(60.0) == 1
    assert "tags.yaml" in process.log_path.read_text()


def test_a_camera_that_is_absent_is_waited_for_and_an_interrupt_ends_it(ros, start, processes, wait_until):
    status = diagnostics(ros, "plane_pose")
    process = start()
    wait_until(lambda: status().get("message") == "waits for images", 30.0, "the status")
    assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()


def test_registered_depth_and_cloud_come_only_while_somebody_listens(ros, camera, processes, wait_until):
    import rospy
    from sensor_msgs.msg import CameraInfo, Image, PointCloud2

    from common.ros.images import array_from_image

    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    status = diagnostics(ros, "register_rgbd")
    wait_until(lambda: status().get("message") == "No subscribers.", 30.0, "the status")
    assert camera.images["rgb"].get_num_connections() == 0
    base = "depth_registered/sw_registered"
    kinds = {
        "depth_registered/points": PointCloud2,
        "rgb/image_rect_color": Image,
        f"{base}/image_rect_raw": Image,
        f"{base}/image_rect": Image,
        f"{base}/camera_info": CameraInfo,
    }
    newest = {}
    subscribers = [
        rospy.Subscriber(f"camera/{topic}", kind, lambda m, topic=topic: newest.update({topic: m}), queue_size=1)
        for topic, kind in kinds.items()
    ]
    wait_until(lambda: len(newest) == len(kinds), 30.0, "all topics")
    cloud, colour, raw, metric, info = (newest[topic] for topic in kinds)
    assert (colour.encoding, raw.encoding, metric.encoding) == ("rgb8", "16UC1", "32FC1")
    depth = array_from_image(metric)
    u, v = np.rint(RGB.rectified().project(TRUTH[:3, 3])).astype(int)
    assert depth[v, u] == pytest.approx(TRUTH[2, 3], abs=0.005)
    assert info.D == (0.0,) * 5
    assert [(f.name, f.offset) for f in cloud.fields] == [("x", 0), ("y", 4), ("z", 8), ("rgb", 12)]
    point = np.frombuffer(cloud.data, "<f4").reshape(480, 640, 4)[v, u]
    np.testing.assert_allclose(point[:3], TRUTH[:3, 3], atol=0.006)
    assert cloud.header.frame_id == metric.header.frame_id == RGB_OPTICAL
    for subscriber in subscribers:
        subscriber.unregister()
    wait_until(lambda: camera.images["rgb"].get_num_connections() == 0, 15.0, "that the camera is left alone")
    assert processes.end(process) == 0
    assert "Traceback" not in process.log_path.read_text()


def test_register_rgbd_names_wrong_parameters(ros):
    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera", "_slop:=2.0", "_slip:=0.1")
    assert process.wait(60.0) == 1
    log = process.log_path.read_text()
    assert "~slop is 2.0" in log and "~slip" in log
    assert "Traceback" not in log


def test_a_image_of_another_size_is_dropped_with_a_sentence(ros, camera, images, wait_until):
    from sensor_msgs.msg import PointCloud2

    camera.depth = images[1][:240, :320].copy()
    clouds, status = ros.record("camera/depth_registered/points", PointCloud2), diagnostics(ros, "register_rgbd")
    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    wait_until(lambda: "Dropped a pair of images" in process.log_path.read_text(), 30.0, "the sentence")
    wait_until(lambda: "Waits for usable images" in status().get("message", ""), 15.0, "the reason")
    camera.depth = images[1]
    clouds.wait(1, 30.0)


def test_the_launch_files_start_what_they_name(ros, camera, wait_until):
    from sensor_msgs.msg import PointCloud2

    from apriltag_ros.msg import AprilTagDetectionArray

    fused = ros.record("tag_detections_fused", AprilTagDetectionArray)
    clouds = ros.record("camera/depth_registered/points", PointCloud2)
    ros.launch("vision", "plane_pose.launch", camera="false")
    ros.launch("vision", "register_rgbd.launch", camera="false", rviz="false")
    wait_until(lambda: fused and fused[-1].detections, 40.0, "the marker board")
    clouds.wait(1, 40.0)


def test_a_recording_goes_through_the_same_nodes(ros, camera, processes, tmp_path, wait_until):
    import rosbag
    import rospy
    from sensor_msgs.msg import PointCloud2

    from apriltag_ros.msg import AprilTagDetectionArray
    from common.ros.conversions import pose_from_message

    bag = tmp_path / "camera.bag"
    topics = [f"/camera/{name}/{topic}" for name in MODELS for topic in ("image_raw", "camera_info")]
    record = processes.start("rosrun", "rosbag", "record", "-O", str(bag), *topics, "/tf_static")
    wait_until(camera.heard_everywhere, 30.0, "the recorder")
    sent = camera.sent
    wait_until(lambda: camera.sent > sent + 10, 30.0, "images to record")
    assert processes.end(record) == 0
    camera.close()
    with rosbag.Bag(str(bag)) as recorded:
        stamps = {message.header.stamp for _, message, _ in recorded.read_messages(topics[:1])}
    assert len(stamps) > 3
    rospy.set_param("use_sim_time", True)
    try:
        seen = {n: ros.record(f"tag_detections{n}", AprilTagDetectionArray) for n in ("", "_fused")}
        clouds = ros.record("camera/depth_registered/points", PointCloud2)
        ros.launch("vision", "camera_apriltag.launch", camera="false", folder=tmp_path)
        ros.launch("vision", "plane_pose.launch", camera="false")
        ros.launch("vision", "register_rgbd.launch", camera="false", rviz="false")
        processes.start("rosbag", "play", "--clock", "--loop", str(bag))
        for arrays in seen.values():
            wait_until(lambda arrays=arrays: arrays and arrays[-1].detections, 60.0, "the marker board")
            np.testing.assert_allclose(pose_from_message(arrays[-1].detections[0].pose.pose.pose), TRUTH, atol=6e-3)
            assert arrays[-1].header.stamp in stamps
        assert clouds.wait(1, 60.0)[-1].header.stamp in stamps
    finally:
        rospy.delete_param("use_sim_time")


def test_the_nodelets_have_the_same_topics(ros, camera, wait_until):
    import rospkg
    from sensor_msgs.msg import Image, PointCloud2

    from common.ros.images import array_from_image
    from vision.ros.camera.register_node import missing_packages

    missing = missing_packages(rospkg.RosPack())
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed")
    metric = ros.record("camera/depth_registered/sw_registered/image_rect", Image)
    clouds = ros.record("camera/depth_registered/points", PointCloud2)
    ros.launch("vision", "register_rgbd.launch", camera="false", rviz="false", nodelets="true")
    u, v = np.rint(RGB.rectified().project(TRUTH[:3, 3])).astype(int)
    assert array_from_image(metric.wait(1, 40.0)[-1])[v, u] == pytest.approx(TRUTH[2, 3], abs=0.005)
    cloud = clouds.wait(1, 40.0)[-1]
    point = np.frombuffer(cloud.data, "<f4").reshape(480, 640, -1)[v, u]
    np.testing.assert_allclose(point[:3], TRUTH[:3, 3], atol=0.006)
