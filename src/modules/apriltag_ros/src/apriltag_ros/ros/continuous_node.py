"""The node apriltag_ros_continuous_node: detects tags in every camera image, on the topics of the published package."""

from __future__ import annotations

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Empty, EmptyResponse

from apriltag_ros.detector import DetectionResult, TagDetector, draw_tags
from apriltag_ros.msg import AprilTagDetectionArray
from apriltag_ros.ros.messages import detection_array, read_parameters
from common import clock
from common.camera_model import camera_model_from_info
from common.errors import ConfigError
from common.ros.broadcaster import FreshBroadcaster
from common.ros.conversions import stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.images import COLOUR, array_from_image, colour_from_image, image_message
from common.ros.inputs import NodeInputs


class ContinuousNode:
    """Detects tags in every image once camera_info has arrived."""

    def __init__(self) -> None:
        self._lock = clock.Lock()
        self._read_parameters()
        self._info: CameraInfo | None = None
        self._images = self._detections = 0
        self._publisher = rospy.Publisher("tag_detections", AprilTagDetectionArray, queue_size=1, tcp_nodelay=True)
        self._drawings = rospy.Publisher("tag_detections_image", Image, queue_size=1)
        self._broadcaster = FreshBroadcaster()
        rospy.Service("~refresh_tag_params", Empty, self._refresh)
        self._inputs = NodeInputs(["image_rect"], once=["camera_info"])
        self._inputs.subscribe("camera_info", CameraInfo, self._on_info)
        self._inputs.subscribe("image_rect", Image, self._on_image)
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
        """Answers an image; raises ValueError if it cannot be used."""
        if self._info is None:
            return
        with self._lock:
            size, rectified = (message.width, message.height), self._settings.rectified
            grey, camera = _grey(message), camera_model_from_info(self._info, size, rectified)
            result = self._detector.detect(grey, camera, message.header.stamp.to_sec())
            self._publish(message.header, result, grey)
        self._inputs.done()

    def _publish(self, header, result: DetectionResult, grey: np.ndarray) -> None:
        throttle_s = 10.0
        self._images += 1
        self._detections += len(result.targets)
        self._publisher.publish(detection_array(result.targets, header))
        if self._settings.publish_tf and result.targets:
            poses = {d.target.name: d.pose.T_camera_tag for d in result.targets}
            self._broadcaster.sendTransform(
                [stamped_transform(T, header.frame_id, name, header.stamp) for name, T in poses.items()]
            )
        if self._settings.publish_tag_detections_image and self._drawings.get_num_connections():
            image = draw_tags(grey, result.tags)
            self._drawings.publish(image_message(image, "bgr8", header.frame_id, header.stamp))
        if result.unknown:
            rospy.logwarn_throttle(
                throttle_s, f"The tags {list(result.unknown)} are visible but unknown: add them to tags.yaml."
            )
        for sentence in result.failed:
            rospy.logwarn_throttle(throttle_s, sentence)

    def _diagnostics(self) -> tuple[int, str, dict[str, object]]:
        return (*self._inputs.status("Detects."), {"pictures": self._images, "detections": self._detections})


def _grey(message: Image) -> np.ndarray:
    """Returns the image in grey; raises ValueError for another encoding."""
    if message.encoding in COLOUR:
        return cv2.cvtColor(np.ascontiguousarray(colour_from_image(message)), cv2.COLOR_RGB2GRAY)
    image = array_from_image(message)
    if image.dtype == np.uint8:
        return image
    needed = ", ".join(("mono8", *COLOUR))
    raise ValueError(f"the image has the encoding {message.encoding}, but the detector needs one of {needed}")


def main() -> None:
    cv2.setNumThreads(1)
    ContinuousNode()
    rospy.spin()
