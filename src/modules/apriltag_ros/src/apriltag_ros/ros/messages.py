"""Between the detector's records and the messages of apriltag_ros."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion

from apriltag_ros.detector import Detection
from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from common.rotations import quaternion_from_rotation


def detection_array(detections: tuple[Detection, ...], header) -> AprilTagDetectionArray:
    """Returns the message of the detections in a picture with the given header."""
    return AprilTagDetectionArray(header, [_detection(detection, header) for detection in detections])


def _detection(detection: Detection, header) -> AprilTagDetection:
    """A tag that stands alone has one id; a bundle has those of all its tags, seen or not, as users know it."""
    T = detection.pose.T_camera_tag
    message = PoseWithCovarianceStamped(header=header)
    message.pose.pose = Pose(Point(*T[:3, 3]), Quaternion(*quaternion_from_rotation(T[:3, :3])))
    message.pose.covariance = np.ravel(detection.pose.covariance).tolist()
    tags = detection.target.tags
    return AprilTagDetection([tag.id for tag in tags], [tag.size for tag in tags], message)
