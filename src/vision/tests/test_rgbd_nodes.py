"""The nodes plane_pose and register_rgbd: what they publish, that they ask for nothing unasked, and how they exit."""

import signal

import numpy as np
import pytest
from depth_scene import RGB, load
from rgbd_scene import MODELS, TRUTH, Camera, images

from common import clock
from common.frames import RGB_OPTICAL

pytestmark = pytest.mark.ros


@pytest.fixture
def ros(virtual_graph):
    return virtual_graph


@pytest.fixture
def camera(ros):
    made = Camera()
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


def interrupted(node):
    """Interrupts a node, and returns its exit code."""
    node.send_signal(signal.SIGINT)
    code = node.wait(1.0)
    assert "Traceback" not in node.log_path.read_text()
    return code


def test_the_board_comes_fused_and_by_its_plane_in_topics_and_tf(ros, camera, start):
    import rospy
    import tf2_ros

    from apriltag_ros.msg import AprilTagDetectionArray
    from common.ros.conversions import pose_from_message, pose_from_transform

    arrays = {n: ros.record(f"tag_detections_{n}", AprilTagDetectionArray) for n in ("fused", "plane")}
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    status = diagnostics(ros, "plane_pose")
    start()
    clock.sleep(0.6)
    assert status()["message"] == "the marker board has a pose with depth"
    assert float(status()["colour_to_fused_mm"]) < 5.0
    for name, messages in arrays.items():
        assert len(messages) >= 4, "every pair of images gives a pose"
        (detection,) = messages[-1].detections
        assert messages[-1].header.frame_id == detection.pose.header.frame_id == RGB_OPTICAL
        assert list(detection.id) == [0, 1, 2, 3, 4]
        np.testing.assert_allclose(pose_from_message(detection.pose.pose.pose), TRUTH, atol=6e-3)
        assert np.linalg.eigvalsh(np.reshape(detection.pose.pose.covariance, (6, 6)))[0] > 0.0
        found = buffer.lookup_transform(RGB_OPTICAL, f"tag_frame/{name}", rospy.Time(0)).transform
        np.testing.assert_allclose(pose_from_transform(found), TRUTH, atol=6e-3)


def test_without_depth_there_is_no_pose_but_a_reason_and_it_comes_back(ros, camera, start):
    from apriltag_ros.msg import AprilTagDetectionArray

    fused = ros.record("tag_detections_fused", AprilTagDetectionArray)
    status = diagnostics(ros, "plane_pose")
    camera.depth = np.zeros_like(camera.depth)
    process = start()
    clock.sleep(0.6)
    assert "have a depth near it" in status()["message"]
    assert fused and not any(message.detections for message in fused)
    assert "No pose with depth" in process.log_path.read_text()
    camera.colour = np.zeros_like(camera.colour)
    clock.sleep(0.6)
    assert "no tag" in status()["message"]
    camera.colour, camera.depth = images()
    clock.sleep(0.15)
    assert fused[-1].detections


def test_what_does_not_belong_together_is_waited_for(ros, camera, start):
    """Images are paired that are less than 0.04 s apart."""
    status = diagnostics(ros, "plane_pose")
    camera.late = 0.041
    start()
    clock.sleep(0.6)
    assert status()["message"] == "waits for images"
    camera.late = 0.039
    clock.sleep(0.6)
    assert status()["message"] == "the marker board has a pose with depth"


@pytest.mark.parametrize(
    ("changes", "faults"),
    [
        ({"panel/frame": "box"}, ("the marker board box",)),
        ({"plane_pose/noise": 0.0, "plane_pose/nose": 1.0}, ("~plane_pose/noise is 0", "~plane_pose/nose")),
        ({"slop": -1.0, "slip": 1.0}, ("~slop is -1", "~slip")),
    ],
)
def test_plane_pose_names_wrong_parameters(start, changes, faults):
    process = start(**changes)
    assert process.wait(1.0) == 1
    log = process.log_path.read_text()
    assert all(fault in log for fault in faults)
    assert "Traceback" not in log


def test_tags_out_of_the_plates_plane_are_refused(start):
    tags = load("tags.yaml")["tag_bundles"]
    tags[0]["layout"][1]["z"] = 0.02
    process = start(**{"detector/tag_bundles": tags})
    assert process.wait(1.0) == 1
    assert "tags.yaml" in process.log_path.read_text()


def test_a_camera_that_is_absent_is_waited_for_and_an_interrupt_stops_the_node(ros, start):
    status = diagnostics(ros, "plane_pose")
    process = start()
    clock.sleep(0.6)
    assert status()["message"] == "waits for images"
    assert interrupted(process) == 0


def test_registered_depth_and_cloud_come_only_while_somebody_listens(ros, camera):
    import rospy
    from sensor_msgs.msg import CameraInfo, Image, PointCloud2

    from common.ros.images import array_from_image

    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    status = diagnostics(ros, "register_rgbd")
    clock.sleep(0.6)
    assert status()["message"] == "No subscribers."
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
    clock.sleep(0.22)
    assert camera.images["rgb"].get_num_connections() == 1, "it looks for subscribers each 0.2 s"
    clock.sleep(0.12)
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
    clock.sleep(0.22)
    assert camera.images["rgb"].get_num_connections() == 0
    assert interrupted(process) == 0


def test_register_rgbd_names_wrong_parameters(ros):
    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera", "_slop:=2.0", "_slip:=0.1")
    assert process.wait(1.0) == 1
    log = process.log_path.read_text()
    assert "~slop is 2.0" in log and "~slip" in log
    assert "Traceback" not in log


def test_an_image_of_another_size_is_dropped_with_a_sentence(ros, camera):
    from sensor_msgs.msg import PointCloud2

    camera.depth = camera.depth[:240, :320].copy()
    clouds, status = ros.record("camera/depth_registered/points", PointCloud2), diagnostics(ros, "register_rgbd")
    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    clock.sleep(0.6)
    assert "Dropped a pair of images" in process.log_path.read_text()
    assert "Waits for usable images" in status()["message"] and not clouds
    camera.depth = images()[1]
    clock.sleep(0.15)
    assert clouds


def test_the_launch_files_start_what_they_name(ros, camera):
    from sensor_msgs.msg import PointCloud2

    from apriltag_ros.msg import AprilTagDetectionArray

    fused = ros.record("tag_detections_fused", AprilTagDetectionArray)
    clouds = ros.record("camera/depth_registered/points", PointCloud2)
    ros.launch("vision", "plane_pose.launch", camera="false")
    ros.launch("vision", "register_rgbd.launch", camera="false", rviz="false", nodelets="false")
    clock.sleep(0.5)
    assert fused[-1].detections and clouds
