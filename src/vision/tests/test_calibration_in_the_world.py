"""The whole calibration in the simulated world: rendered images, detector, moving arm, and the truth."""

import re

import numpy as np
import pytest

from common.poses import inverse, pose
from common.rotations import rotation_angle

pytest.importorskip("rig_msgs.srv")
from pathlib import Path

import rospy
import tf2_ros
import yaml

from apriltag_ros.msg import AprilTagDetectionArray
from common.ros.conversions import pose_from_transform
from rig_simulation.files import read_scene
from rig_simulation.world.model import RGB_IN_LINK, camera_link_pose
from rig_simulation.world.scene import scene_from
from vision.camera.frames import R_CAMERA_OPTICAL
from vision.ros.calibration.calibration_setup import read

pytestmark = [pytest.mark.ros, pytest.mark.long]


def optical_frame_in_the_world():
    """T_base_camera of the scene `empty`, shape (4, 4)."""
    return camera_link_pose(scene_from(read_scene("empty")).camera) @ pose(R_CAMERA_OPTICAL, RGB_IN_LINK)


def error(T, truth):
    """Returns how far apart two poses are [mm, deg]."""
    between = inverse(truth) @ T
    return 1e3 * np.linalg.norm(between[:3, 3]), np.degrees(rotation_angle(between[:3, :3]))


@pytest.fixture
def world(processes, wait_until):
    """Ports of arm and world."""
    names = ("--port", "--control-port", "--hand-port", "--hand-control-port", "--world-port")
    free = [word for name in names for word in (name, "0")]
    program = processes.start("rosrun", "rig_simulation", "world.py", *free, "--scene", "empty", "--panel", "bundle")
    text = wait_until(lambda: (lambda t: t if "world: scene" in t else None)(program.log_path.read_text()), 60.0, "it")
    return re.search(r"listening on 127.0.0.1:(\d+)", text)[1], re.search(r"world: .*:(\d+)", text)[1]


@pytest.mark.timeout(900)
def test_from_a_wrong_guess_to_3_mm_and_it_is_there_at_the_next_start(ros, world, processes, wait_until, tmp_path):
    robot_port, world_port = world
    arguments = {"sim": "true", "port": world_port, "control_port": "0", "folder": tmp_path}
    launch = ros.launch("vision", "camera_apriltag.launch", **arguments)
    ros.record("tag_detections", AprilTagDetectionArray).wait(3, 60.0)
    rospy.set_param("camera_calibration/views/guess_position", [1.0, 0.0, 0.65])
    rospy.set_param("camera_calibration/views/tries", 300)
    rospy.set_param("camera_calibration/views/count", 10)
    rospy.set_param("camera_calibration/limits/pictures", 5)
    options = ("--ip", "127.0.0.1", "--port", robot_port, "--velocity", "0.5", "--yes")
    program = processes.start("rosrun", "vision", "calibrate_camera.py", *options)
    assert program.wait(600.0) == 0, program.log_path.read_text()
    (file,) = tmp_path.glob("camera_place_*.yaml")
    record = read(file)
    assert record.simulated is True
    shift, turn = error(record.T_base_camera, optical_frame_in_the_world())
    assert shift < 3.0 and turn < 0.3, (shift, turn)
    assert processes.end(launch) == 0

    again = ros.launch("vision", "camera_apriltag.launch", camera="false", **arguments)
    wait_for_frames = processes.start("rosrun", "vision", "camera_frames_node.py", *frames())
    text = f"The camera pose is that of {file}"
    wait_until(lambda: text in again.log_path.read_text(), 40.0, "the stored pose")
    assert wait_for_frames.poll() is None
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)
    found = buffer.lookup_transform(
        "kuka/base_frame", record.camera_frame, rospy.Time(0), rospy.Duration(60.0)
    ).transform
    listener.unregister()
    np.testing.assert_allclose(pose_from_transform(found), record.T_base_camera, atol=1e-6)


def frames():
    """Private parameters of the node that publishes the camera's frames."""
    values = yaml.safe_load((Path(__file__).parents[1] / "config" / "camera_frames.yaml").read_text())
    return [f"_{key}:={value}" for key, value in values.items()]
