"""Programs that are not ours with the camera's nodes: a recording by rosbag, and the nodelets of depth_image_proc."""

import numpy as np
import pytest
from depth_scene import RGB
from rgbd_scene import MODELS, TRUTH, Camera

pytest.importorskip("rig_msgs.srv")
import rospkg
import rospy
from sensor_msgs.msg import Image, PointCloud2

from apriltag_ros.msg import AprilTagDetectionArray
from common.ros.conversions import pose_from_message
from common.ros.images import array_from_image
from vision.ros.camera.register_node import missing_packages

pytest.importorskip("rospy")
pytestmark = [pytest.mark.ros, pytest.mark.long]


@pytest.fixture
def camera(ros):
    made = Camera()
    yield made
    made.close()


def test_a_recording_goes_through_the_same_nodes(ros, camera, processes, tmp_path, wait_until):
    import rosbag

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
    assert stamps
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
