"""Receives the detections of the marker board from the detector node."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping

import numpy as np
import rospy

from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from apriltag_ros.settings import TAG_KEYS, targets
from apriltag_ros.target import TagTarget
from common.errors import ConfigError
from common.poses import pose
from common.ros.conversions import array
from common.rotations import rotation_from_quaternion
from vision.calibration.acceptance import BoardDetection

POLL_S = 0.05


def board_target(detector: Mapping, name: str, frame: str) -> TagTarget:
    """Returns the tag or bundle `frame` in the parameters of the detector; `name` is theirs.

    Raises:
        ConfigError: the detector has no such target.
    """
    found = targets({key: detector.get(key) for key in TAG_KEYS})
    for target in found:
        if target.name == frame:
            return target
    names = ", ".join(target.name for target in found)
    raise ConfigError([f"{name} detects {names}, but not the marker board {frame}: use its tags.yaml and panel.yaml."])


class BoardListener:
    """Subscribes to the detector.

    Args:
        target: the marker board.
        on_detection: callback with stamp, optical frame and detection for every image that shows the marker board.

    Attributes:
        frame: optical frame of the camera; empty before the first detection.
        alive: whether the detector has published.
    """

    def __init__(
        self, target: TagTarget, on_detection: Callable[[rospy.Time, str, BoardDetection], None] | None = None
    ) -> None:
        self._ids = tuple(tag.id for tag in target.tags)
        self._on_detection = on_detection
        self._lock = threading.Lock()
        self._after = rospy.Time(0)
        self._detections: list[tuple[rospy.Time, BoardDetection]] = []
        self.frame = ""
        self.alive = False
        rospy.Subscriber("tag_detections", AprilTagDetectionArray, self._on_message, queue_size=1, tcp_nodelay=True)

    def collect(self, count: int, timeout: float) -> list[tuple[rospy.Time, BoardDetection]]:
        """Returns up to `count` detections in images from now on, with their stamps; fewer after `timeout` [s]."""
        with self._lock:
            self._after, self._detections = rospy.Time.now(), []
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline and not rospy.is_shutdown():
            with self._lock:
                if len(self._detections) >= count:
                    return self._detections[:count]
            time.sleep(POLL_S)
        with self._lock:
            return list(self._detections)

    def _on_message(self, message: AprilTagDetectionArray) -> None:
        self.alive = True
        for entry in message.detections:
            if tuple(entry.id) != self._ids:
                continue
            try:
                detection = _detection(entry)
            except ValueError as error:
                rospy.logwarn_throttle(10.0, f"Dropped a detection: {error}.")
                continue
            with self._lock:
                self.frame = message.header.frame_id
                if message.header.stamp > self._after:
                    self._detections.append((message.header.stamp, detection))
            if self._on_detection is not None:
                self._on_detection(message.header.stamp, message.header.frame_id, detection)


def _detection(message: AprilTagDetection) -> BoardDetection:
    """Returns the detection; raises ValueError for numbers that are not a pose, or an empty covariance."""
    q = message.pose.pose.pose.orientation
    position, covariance = array(message.pose.pose.pose.position), np.reshape(message.pose.pose.covariance, (6, 6))
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(covariance))):
        raise ValueError("its numbers are not finite")
    if np.linalg.eigvalsh((covariance + covariance.T) / 2.0)[0] <= 0.0:
        raise ValueError("its covariance is not positive; use a detector that fills it in, such as ours")
    return BoardDetection(pose(rotation_from_quaternion([q.x, q.y, q.z, q.w]), position), covariance)
