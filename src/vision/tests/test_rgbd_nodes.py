"""The nodes plane_pose and register_rgbd: what they publish, that they ask for nothing unasked, and how they exit."""

import signal

import numpy as np
import pytest
from depth_scene import RGB, load
from rgbd_scene import MODELS, TRUTH, Camera, images

from common import clock
from common.frames import RGB_OPTICAL
from common.poses import pose
from common.rotations import rotation_about

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from apriltag_ros.msg import AprilTagDetectionArray
from common.frames import DEPTH_OPTICAL
from common.ros.conversions import pose_from_message, pose_from_transform, stamped_transform
from common.ros.images import array_from_image

pytestmark = pytest.mark.ros


@pytest.fixture
def camera(ros):
    made = Camera()
    yield made
    made.close()


@pytest.fixture
def start(ros):
    """Starts the node plane_pose with the package's parameters and changes to them."""

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
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def read() -> dict:
        found = [s for array in arrays for s in array.status if s.name == name]
        if not found:
            return {}
        values = {v.key: v.value for v in found[-1].values}
        return {"message": found[-1].message, "level": found[-1].level, **values}

    return read


def interrupted(node):
    """Interrupts a node, and returns its exit code."""
    node.send_signal(signal.SIGINT)
    code = node.wait(1.0)
    assert "Traceback" not in node.log_path.read_text()
    return code


def test_the_board_comes_fused_and_by_its_plane_in_topics_and_tf(ros, camera, start):
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


def test_images_that_are_less_than_40_ms_apart_are_paired(ros, camera, start):
    status = diagnostics(ros, "plane_pose")
    camera.late = 0.041
    start()
    clock.sleep(0.6)
    assert "0.041 s apart, but at most 0.04 s are allowed" in status()["message"]
    camera.late = 0.039
    clock.sleep(0.6)
    assert status()["message"] == "the marker board has a pose with depth"


def changed(name, kind, **values):
    """An edit of the messages of one camera, infos or images: other values, False for those that do not come."""

    def edit(camera, message):
        if camera == name and message._type == f"sensor_msgs/{kind}":
            for key, value in values.items():
                setattr(message, key, value)
            return bool(values)
        return True

    return edit


def frame(text):
    def edit(camera, message):
        message.header.frame_id = text.format(message.header.frame_id)
        return True

    return edit


ZEROS = [0.0] * 9
USED = [  # as image_geometry takes it
    changed("rgb", "CameraInfo", width=0, height=0),
    frame("/{}"),
]
MILLIMETRES = np.full((480, 640), 900.0, np.float32).tobytes()
REFUSED = [
    (changed("rgb", "Image"), "nothing has come on /camera/rgb/image_raw"),
    (changed("depth", "Image"), "nothing has come on /camera/depth/image_raw"),
    (changed("rgb", "Image", encoding="yuv422"), "the colour image has the encoding yuv422"),
    (changed("depth", "Image", encoding="rgb8"), "cannot have rows of"),
    (changed("depth", "Image", encoding="mono8", step=640, data=bytes(640 * 480)), "image has the encoding mono8"),
    (changed("depth", "Image", data=b"torn"), "4 bytes instead of"),
    (changed("depth", "Image", encoding="32FC1", step=2560, data=MILLIMETRES), "the median of the depth is 900 m"),
    (changed("rgb", "CameraInfo", width=320, height=240), "640 x 480, but its camera_info says 320 x 240"),
    (changed("depth", "CameraInfo", K=ZEROS), "not calibrated"),
    (frame("new_{}"), "tf does not know the frame 'new_camera_depth_optical_frame'"),
    (frame(""), "without a frame"),
]  # fmt: skip


def started(ros, start, node):
    """Starts register_rgbd or plane_pose; returns its process, its status, and what comes out of it."""
    status = diagnostics(ros, node)
    if node == "plane_pose":
        return start(), status, ros.record("tag_detections_fused", AprilTagDetectionArray)
    process = ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    return process, status, ros.record("camera/depth_registered/sw_registered/image_rect", Image)


FINE = {"plane_pose": "the marker board has a pose with depth", "register_rgbd": "Registers."}


@pytest.mark.parametrize("node", FINE)
def test_what_image_geometry_takes_is_used(ros, camera, start, node):
    _, status, out = started(ros, start, node)
    clock.sleep(0.4)
    for edit in USED:
        camera.edit = edit
        clock.sleep(0.15)
        before = len(out)
        clock.sleep(0.15)
        assert len(out) > before and out[-1].header.frame_id == RGB_OPTICAL
        if node == "register_rgbd":
            assert np.isfinite(np.frombuffer(out[-1].data, "<f4")).mean() > 0.5
    clock.sleep(0.5)
    assert status()["message"] == FINE[node]


@pytest.mark.parametrize("node", FINE)
def test_the_first_thing_that_is_wrong_is_said_and_logged_once(ros, camera, start, node):
    process, status, out = started(ros, start, node)
    for edit, reason in REFUSED:
        camera.edit = edit
        clock.sleep(2.6)
        assert reason[1:] in status()["message"] and status()["level"] == 1
        assert not out or (rospy.Time.now() - out[-1].header.stamp).to_sec() > 2.0
        before = process.log_path.read_text().count("No output: ")  # a fault that lasts is logged after a second
        clock.sleep(2.0)
        log = process.log_path.read_text()
        assert reason in log and log.count("No output: ") == before
        camera.edit = lambda name, message: True
        clock.sleep(0.8)
        assert status()["message"] == FINE[node]
    assert "Traceback" not in log


def test_depth_that_falls_nowhere_into_the_colour_image_is_no_output(ros, camera):
    status = diagnostics(ros, "register_rgbd")
    out = ros.record("camera/depth_registered/sw_registered/image_rect", Image)
    ros.run("vision", "register_rgbd_node.py", "__ns:=camera")
    camera.depth = np.zeros_like(camera.depth)
    clock.sleep(2.0)
    assert status()["message"] == "The depth image holds no reading." and out
    camera.depth = images()[1]
    tf2_ros.StaticTransformBroadcaster().sendTransform(
        stamped_transform(pose(rotation_about(1, np.pi)), RGB_OPTICAL, DEPTH_OPTICAL, rospy.Time.now())
    )
    clock.sleep(2.0)
    assert "no reading of the depth image falls into the colour image" in status()["message"].lower()


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
    missing = ", ".join(f"/camera/{name}/{kind}" for kind in ("image_raw", "camera_info") for name in MODELS)
    assert status()["message"] == f"nothing has come on {missing}"
    assert interrupted(process) == 0


def test_registered_depth_and_cloud_come_only_while_somebody_listens(ros, camera):
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


def test_the_launch_files_start_what_they_name(ros, camera):
    fused = ros.record("tag_detections_fused", AprilTagDetectionArray)
    clouds = ros.record("camera/depth_registered/points", PointCloud2)
    ros.launch("vision", "plane_pose.launch", camera="false")
    ros.launch("vision", "register_rgbd.launch", camera="false", rviz="false", nodelets="false")
    clock.sleep(0.5)
    assert fused[-1].detections and clouds
