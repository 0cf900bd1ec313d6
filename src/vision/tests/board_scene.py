"""A camera, a detector and an arm's controller of a few lines, for tests of the nodes: the marker board is seen where
it is.

The flange's pose comes from the test; the camera stands at a known place.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from common import clock
from common.config import parse
from common.poses import inverse, pose
from vision.marker_board.board import MarkerBoardConfig

CONFIG = Path(__file__).parents[1] / "config"
OPTICAL, DETECTOR = "camera_rgb_optical_frame", "apriltag_ros_continuous_node"
T_LINK_OPTICAL = pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], (0.0, -0.045, 0.0))
T_FLANGE_BOARD = parse(MarkerBoardConfig, yaml.safe_load((CONFIG / "panel.yaml").read_text())).T_flange_tag
SD = np.array([3e-4, 3e-4, 6e-4, 1.5e-3, 1.5e-3, 5e-4])


def parameters(folder, **views):
    """What camera_apriltag.launch puts under camera_calibration/."""
    load = {name: yaml.safe_load((CONFIG / file).read_text()) for name, file in FILES.items()}
    load["views"].update(views)
    store = {"folder": str(folder), "camera": "1234", "robot": "LBR7R800", "flange": "MF_elektrisch"}
    return {**load, "store": store}


FILES = {"panel": "panel.yaml", "limits": "camera_calibration.yaml", "views": "calibration_views.yaml"}


class BoardScene:
    """Publishes camera_info, tag_detections and tf, twenty times a second.

    Args:
        T_base_camera, T_flange_board: the truth, shape (4, 4) [m].
        flange: returns T_base_flange, shape (4, 4), or None while nobody measures it.
        measured: whether the flange is published in tf.
    """

    def __init__(self, T_base_camera, T_flange_board, flange, measured=True):
        import rospy
        import tf2_ros
        from sensor_msgs.msg import CameraInfo

        from apriltag_ros.msg import AprilTagDetectionArray
        from common.camera_model import pinhole
        from common.ros.conversions import stamped_transform

        self.T_base_camera, self.T_flange_board, self.flange, self.measured = (
            T_base_camera,
            T_flange_board,
            flange,
            measured,
        )
        self.visible, self.noise, self.sd = True, SD / 3.0, SD
        self.detects, self.frame = True, OPTICAL  # whether the detector publishes, and in which frame
        rospy.set_param("camera/driver/serial", "simulated")
        rospy.set_param(DETECTOR, yaml.safe_load((CONFIG / "tags.yaml").read_text()))
        self._model = pinhole("test", 640, 480, [[545.0, 0, 319.5], [0, 545.0, 239.5], [0, 0, 1]])
        self._rng = np.random.default_rng(0)
        self._infos = rospy.Publisher("camera/rgb/camera_info", CameraInfo, queue_size=1)
        self._detections = rospy.Publisher("tag_detections", AprilTagDetectionArray, queue_size=1)
        self._broadcaster = tf2_ros.TransformBroadcaster()
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._static.sendTransform(stamped_transform(T_LINK_OPTICAL, "camera_link", OPTICAL, rospy.Time.now()))
        self._ended = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join(5.0)

    def _loop(self):
        while not self._ended.wait(0.05):
            self._publish()

    def _publish(self):
        import rospy
        from std_msgs.msg import Header

        from apriltag_ros.msg import AprilTagDetectionArray
        from common.ros.conversions import stamped_transform
        from common.ros.images import camera_info_message

        stamp = rospy.Time.now()
        self._infos.publish(camera_info_message(self._model, OPTICAL, stamp))
        T_base_flange = self.flange()
        message = AprilTagDetectionArray(header=Header(stamp=stamp, frame_id=self.frame))
        if T_base_flange is not None:
            if self.measured:
                transform = stamped_transform(T_base_flange, "kuka/base_frame", "kuka/flange_frame/measured", stamp)
                self._broadcaster.sendTransform(transform)
            if self.visible:
                message.detections.append(self._detection(T_base_flange, message.header))
        if self.detects:
            self._detections.publish(message)

    def _detection(self, T_base_flange, header):
        from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion

        from apriltag_ros.msg import AprilTagDetection
        from common.rotations import quaternion_from_rotation

        T = inverse(self.T_base_camera) @ T_base_flange @ self.T_flange_board
        noise = self._rng.normal(0.0, self.noise)
        T = pose(pin.exp3(noise[3:]) @ T[:3, :3], T[:3, 3] + noise[:3])
        stamped = PoseWithCovarianceStamped(header=header)
        stamped.pose.pose = Pose(Point(*T[:3, 3]), Quaternion(*quaternion_from_rotation(T[:3, :3])))
        stamped.pose.covariance = np.diag(self.sd**2).ravel().tolist()
        return AprilTagDetection([0, 1, 2, 3, 4], [0.1, 0.06, 0.06, 0.06, 0.06], stamped)
