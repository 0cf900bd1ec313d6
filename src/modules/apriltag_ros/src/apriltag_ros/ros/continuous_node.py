"""The node apriltag_ros_continuous_node: pictures of a camera in, detections out, on the topics of the ROS package."""

from __future__ import annotations

import threading

import cv2
import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Empty, EmptyResponse

from apriltag_ros.detector import Detections, TagDetector
from apriltag_ros.drawing import drawn
from apriltag_ros.msg import AprilTagDetectionArray
from apriltag_ros.ros import parameters
from apriltag_ros.ros.messages import detection_array
from common.errors import ConfigError
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.images import array_from_image, camera_model_from_info, image_message
from common.ros.node import run, while_running

BUFFER_BYTES = 2**24
"""Room for many pictures: rospy drops all but the newest only among those that it has read."""
THROTTLE_S = 10.0
SILENT_S = 2.0

GREY = {"rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY}


class ContinuousNode:
    """Detects in every picture for which the camera's description has come."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._read_parameters()
        self._info: CameraInfo | None = None
        self._pictures = self._detections = 0
        self._last_picture: rospy.Time | None = None
        self._publisher = rospy.Publisher("tag_detections", AprilTagDetectionArray, queue_size=1, tcp_nodelay=True)
        self._drawings = rospy.Publisher("tag_detections_image", Image, queue_size=1)
        self._broadcaster = tf2_ros.TransformBroadcaster()
        rospy.Service("~refresh_tag_params", Empty, self._refresh)
        rospy.Subscriber("camera_info", CameraInfo, self._on_info, queue_size=1)
        rospy.Subscriber("image_rect", Image, self._on_image, queue_size=1, buff_size=BUFFER_BYTES, tcp_nodelay=True)
        Diagnostics("apriltag_ros", self._diagnostics)

    def _read_parameters(self) -> None:
        settings, targets = parameters.read()
        self._settings, self._detector = settings, TagDetector(settings, targets)
        rospy.loginfo("%s", settings)
        rospy.loginfo("Looking for %s.", ", ".join(f"{t.name} (ids {[tag.id for tag in t.tags]})" for t in targets))

    def _refresh(self, _) -> EmptyResponse:
        """Reads the parameters anew; with faults in them the old ones stay."""
        with self._lock:
            try:
                self._read_parameters()
            except ConfigError as error:
                raise rospy.ServiceException(f"The old parameters stay: {error}") from error
        return EmptyResponse()

    def _on_info(self, message: CameraInfo) -> None:
        self._info = message

    def _on_image(self, message: Image) -> None:
        info = self._info
        if info is None:
            rospy.loginfo_throttle(THROTTLE_S, f"Waiting for {rospy.resolve_name('camera_info')}.")
            return
        with while_running(), self._lock:
            try:
                grey = _grey(message)
                result = self._detector.detect(grey, camera_model_from_info(info), message.header.stamp.to_sec())
            except ValueError as error:
                rospy.logerr_throttle(THROTTLE_S, f"A picture was dropped: {error}.")
                return
            self._publish(message.header, result, grey)

    def _publish(self, header, result: Detections, grey: np.ndarray) -> None:
        self._pictures += 1
        self._detections += len(result.targets)
        self._last_picture = rospy.Time.now()
        self._publisher.publish(detection_array(result.targets, header))
        if self._settings.publish_tf and result.targets:
            self._broadcaster.sendTransform(
                [
                    stamped_transform(d.pose.T_camera_tag, header.frame_id, d.target.name, header.stamp)
                    for d in result.targets
                ]
            )
        if self._settings.publish_tag_detections_image and self._drawings.get_num_connections():
            picture = drawn(grey, result.found)
            self._drawings.publish(image_message(picture, "bgr8", header.frame_id, header.stamp))
        if result.unknown:
            rospy.logwarn_throttle(THROTTLE_S, f"The tags {list(result.unknown)} are in view, but in no yaml.")
        for sentence in result.failed:
            rospy.logwarn_throttle(THROTTLE_S, sentence)

    def _diagnostics(self):
        values = {"pictures": self._pictures, "detections": self._detections}
        if self._last_picture is None:
            return DiagnosticStatus.WARN, f"waits for {rospy.resolve_name('image_rect')}", values
        age = (rospy.Time.now() - self._last_picture).to_sec()
        if age > SILENT_S:
            return DiagnosticStatus.WARN, f"no pictures for {age:.1f} s", values
        return DiagnosticStatus.OK, "detects", values


def _grey(message: Image) -> np.ndarray:
    """Raises ValueError for a picture that cannot be made grey."""
    picture = array_from_image(message)
    if message.encoding in GREY:
        return cv2.cvtColor(picture, GREY[message.encoding])
    if picture.ndim == 2 and picture.dtype == np.uint8:
        return picture
    raise ValueError(f"tags are not looked for in pictures with the encoding {message.encoding}")


def _run() -> None:
    cv2.setNumThreads(1)
    ContinuousNode()
    rospy.spin()


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("apriltag_ros_continuous_node", _run)
