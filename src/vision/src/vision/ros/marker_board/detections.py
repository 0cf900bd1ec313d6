"""The panel as the detector sees it: the newest sights, and those that come after a moment."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import rospy

from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from apriltag_ros.settings import TAG_KEYS, targets
from apriltag_ros.target import Target
from common.errors import ConfigError
from common.poses import pose
from common.ros.conversions import array
from common.ros.params import wait_for_param
from common.rotations import rotation_from_quaternion
from vision.calibration.acceptance import Sight

POLL_S = 0.05


def panel_target(detector: str, frame: str) -> Target:
    """Returns the tag or bundle `frame` that the node `detector` looks for; waits for its parameters.

    Raises:
        ConfigError: it looks for no such tag.
    """
    wait_for_param(detector)
    values = rospy.get_param(detector)
    found = targets({key: values.get(key) for key in TAG_KEYS})
    for target in found:
        if target.name == frame:
            return target
    raise ConfigError([f"{detector} looks for {', '.join(t.name for t in found)}, but not for the panel {frame}."])


class PanelSights:
    """Listens to the detector.

    Args:
        target: the panel.
        on_sight: is called with stamp, optical frame and sight of every picture that shows the panel.
    """

    def __init__(self, target: Target, on_sight: Callable[[rospy.Time, str, Sight], None] | None = None) -> None:
        self._ids = tuple(tag.id for tag in target.tags)
        self._on_sight = on_sight
        self._lock = threading.Lock()
        self._after = rospy.Time(0)
        self._sights: list[tuple[rospy.Time, Sight]] = []
        self.frame = ""
        self.last_picture: float | None = None
        rospy.Subscriber("tag_detections", AprilTagDetectionArray, self._on_detections, queue_size=1, tcp_nodelay=True)

    def collect(self, count: int, timeout: float) -> list[Sight]:
        """Returns up to `count` sights in pictures that are taken from now on; fewer if the time [s] runs out."""
        return [sight for _, sight in self.collect_stamped(count, timeout)]

    def collect_stamped(self, count: int, timeout: float) -> list[tuple[rospy.Time, Sight]]:
        """Returns what `collect` does, each with the stamp of its picture."""
        with self._lock:
            self._after, self._sights = rospy.Time.now(), []
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline and not rospy.is_shutdown():
            with self._lock:
                if len(self._sights) >= count:
                    return self._sights[:count]
            time.sleep(POLL_S)
        with self._lock:
            return list(self._sights)

    def _on_detections(self, message: AprilTagDetectionArray) -> None:
        self.last_picture = time.monotonic()
        for detection in message.detections:
            if tuple(detection.id) != self._ids:
                continue
            try:
                sight = _sight(detection)
            except ValueError as error:
                rospy.logwarn_throttle(10.0, f"A detection was dropped: {error}.")
                continue
            with self._lock:
                self.frame = message.header.frame_id
                if message.header.stamp > self._after:
                    self._sights.append((message.header.stamp, sight))
            if self._on_sight is not None:
                self._on_sight(message.header.stamp, message.header.frame_id, sight)


def _sight(detection: AprilTagDetection) -> Sight:
    """Raises ValueError for numbers that are no pose, or a covariance that nobody filled in."""
    p, q = detection.pose.pose.pose.position, detection.pose.pose.pose.orientation
    position, covariance = array(p), np.reshape(detection.pose.pose.covariance, (6, 6))
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(covariance))):
        raise ValueError("its numbers are not finite")
    if np.linalg.eigvalsh((covariance + covariance.T) / 2.0)[0] <= 0.0:
        raise ValueError("its covariance is not positive; the detector has to state one")
    return Sight(pose(rotation_from_quaternion([q.x, q.y, q.z, q.w]), position), covariance)
