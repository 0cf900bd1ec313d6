"""The process of the node ggcnn: what Ctrl-C does while torch and the networks load, and while it works."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from table_scene import CAMERA

from common.frames import DEPTH_OPTICAL

pytest.importorskip("rig_msgs.srv")
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.ros.images import camera_info_message, image_message
from grasp_msgs.msg import GraspList

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

PATIENCE_S = 60.0


@pytest.mark.parametrize(
    "moment",
    [
        pytest.param("its libraries load", marks=pytest.mark.real),
        *(pytest.param(moment, marks=pytest.mark.long) for moment in ("its networks load", "it works")),
    ],
)
def test_interrupted_it_ends_whatever_it_does(ros, wait_until, moment):
    lists = ros.record("ggcnn/out/grasps", GraspList)
    images = rospy.Publisher("camera/depth/image", Image, queue_size=1)
    infos = rospy.Publisher("camera/depth/camera_info", CameraInfo, queue_size=1)
    process = ros.run("grasping", "ggcnn.py")

    def works():
        now = rospy.Time.now()
        infos.publish(camera_info_message(CAMERA, DEPTH_OPTICAL, now))
        images.publish(image_message(np.zeros((480, 640), np.uint16), "16UC1", DEPTH_OPTICAL, now))
        return any("no reading" in message.reason for message in lists)

    condition = {
        "its libraries load": lambda: "libtorch" in Path(f"/proc/{process.pid}/maps").read_text(),
        "its networks load": lambda: "tool: hand" in process.log_path.read_text(),
        "it works": works,
    }[moment]
    wait_until(condition, PATIENCE_S, moment)
    process.send_signal(signal.SIGINT)
    code = process.wait(PATIENCE_S)
    assert code == 0 or (code == -signal.SIGINT and moment == "its libraries load")
    assert "Traceback" not in process.log_path.read_text()
