"""The ROS side of the detector's records: private parameters to settings, detections to messages."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovarianceStamped, Quaternion

from apriltag_ros.detector import TargetDetection
from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from apriltag_ros.settings import TAG_KEYS, DetectorSettings, TagTarget, detector_settings, targets
from common.ros.params import private_values
from common.rotations import quaternion_from_rotation

OTHERS = ("queue_size", "camera_frame", "tag_border")
"""Keys in launch files of the published package that have no effect here."""


def read_parameters() -> tuple[DetectorSettings, tuple[TagTarget, ...]]:
    """Returns the settings and the targets; raises ConfigError with all faults of the parameters."""
    values = private_values()
    settings = detector_settings(values, prefix="~", others=OTHERS)
    return settings, targets({key: values.get(key) for key in TAG_KEYS})


def detection_array(detections: tuple[TargetDetection, ...], header) -> AprilTagDetectionArray:
    """Returns the message of the detections in an image with the given header."""
    return AprilTagDetectionArray(header, [_detection(detection, header) for detection in detections])


def _detection(detection: TargetDetection, header) -> AprilTagDetection:
    """Returns the message of one target. As in the published package, a bundle has the ids of all its tags, detected or
    not."""
    T = detection.pose.T_camera_tag
    message = PoseWithCovarianceStamped(header=header)
    message.pose.pose = Pose(Point(*T[:3, 3]), Quaternion(*quaternion_from_rotation(T[:3, :3])))
    message.pose.covariance = np.ravel(detection.pose.covariance).tolist()
    tags = detection.target.tags
    return AprilTagDetection([tag.id for tag in tags], [tag.size for tag in tags], message)
