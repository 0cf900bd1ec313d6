"""The node apriltag_ros_continuous_node: detects tags in every camera image, on the topics of the published package."""

from __future__ import annotations

import cv2
import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Empty, EmptyResponse

from apriltag_ros.detector import DetectionResult, TagDetector, draw_tags
from apriltag_ros.msg import AprilTagDetectionArray
from apriltag_ros.ros.messages import detection_array, read_parameters
from common import clock
from common.errors import ConfigError
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.images import array_from_image, camera_model_from_info, image_message
from common.ros.node import while_running

BUFFER_BYTES = 2**24
"""Room for several images: rospy drops old images only after it has read them."""
THROTTLE_S = 10.0
SILENT_S = 2.0
GREY = {"rgb8": cv2.COLOR_RGB2GRAY, "bgr8": cv2.COLOR_BGR2GRAY}


class ContinuousNode:
    """Detects tags in every image once camera_info has arrived."""

    def __init__(self) -> None:
        self._lock = clock.Lock()
        self._read_parameters()
        self._info: CameraInfo | None = None
        self._images = self._detections = 0
        self._last_image: rospy.Time | None = None
        self._publisher = rospy.Publisher("tag_detections", AprilTagDetectionArray, queue_size=1, tcp_nodelay=True)
        self._drawings = rospy.Publisher("tag_detections_image", Image, queue_size=1)
        self._broadcaster = tf2_ros.TransformBroadcaster()
        rospy.Service("~refresh_tag_params", Empty, self._refresh)
        rospy.Subscriber("camera_info", CameraInfo, self._on_info, queue_size=1)
        rospy.Subscriber("image_rect", Image, self._on_image, queue_size=1, buff_size=BUFFER_BYTES, tcp_nodelay=True)
        Diagnostics("apriltag_ros", self._diagnostics)

    def _read_parameters(self) -> None:
        self._settings, targets = read_parameters()
        self._detector = TagDetector(self._settings, targets)
        rospy.loginfo("%s", self._settings)
        rospy.loginfo("Detecting %s.", ", ".join(f"{t.name} (ids {[tag.id for tag in t.tags]})" for t in targets))

    def _refresh(self, _) -> EmptyResponse:
        """Reads the parameters again; keeps the old ones if the new ones have faults."""
        with self._lock:
            try:
                self._read_parameters()
            except ConfigError as error:
                raise rospy.ServiceException(f"The old parameters stay in use: {error}") from error
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
                rospy.logerr_throttle(THROTTLE_S, f"Dropped an image: {error}.")
                return
            self._publish(message.header, result, grey)

    def _publish(self, header, result: DetectionResult, grey: np.ndarray) -> None:
        self._images += 1
        self._detections += len(result.targets)
        self._last_image = rospy.Time.now()
        self._publisher.publish(detection_array(result.targets, header))
        if self._settings.publish_tf and result.targets:
            self._broadcaster.sendTransform(
                [
                    stamped_transform(d.pose.T_camera_tag, header.frame_id, d.target.name, header.stamp)
                    for d in result.targets
                ]
            )
        if self._settings.publish_tag_detections_image and self._drawings.get_num_connections():
            image = draw_tags(grey, result.tags)
            self._drawings.publish(image_message(image, "bgr8", header.frame_id, header.stamp))
        if result.unknown:
            rospy.logwarn_throttle(
                THROTTLE_S, f"The tags {list(result.unknown)} are visible but unknown: add them to tags.yaml."
            )
        for sentence in result.failed:
            rospy.logwarn_throttle(THROTTLE_S, sentence)

    def _diagnostics(self):
        values = {"pictures": self._images, "detections": self._detections}
        if self._last_image is None:
            return DiagnosticStatus.WARN, f"waits for {rospy.resolve_name('image_rect')}", values
        age = (rospy.Time.now() - self._last_image).to_sec()
        if age > SILENT_S:
            return DiagnosticStatus.WARN, f"no images for {age:.1f} s: is the camera running?", values
        return DiagnosticStatus.OK, "detects", values


def _grey(message: Image) -> np.ndarray:
    """Returns the image in grey; raises ValueError for another encoding."""
    image = array_from_image(message)
    if message.encoding in GREY:
        return cv2.cvtColor(image, GREY[message.encoding])
    if image.ndim == 2 and image.dtype == np.uint8:
        return image
    raise ValueError(f"its encoding is {message.encoding}, but the detector needs mono8, rgb8 or bgr8")


def main() -> None:
    """Runs the node with its private parameters."""
    cv2.setNumThreads(1)
    ContinuousNode()
    rospy.spin()
