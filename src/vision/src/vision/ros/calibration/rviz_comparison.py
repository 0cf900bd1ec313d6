"""Shows an old and a new camera pose in RViz, as frames and as markers."""

from __future__ import annotations

import time

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.frames import BASE
from common.ros.conversions import stamped_transform

TOPIC = "camera_calibration/markers"
COLOURS = {"old": (0.55, 0.55, 0.55), "new": (0.1, 0.7, 0.2)}
DEPTH_M, HALF_WIDTH_M, HALF_HEIGHT_M = 0.15, 0.09, 0.066
LINE_M = 0.004
VIEWER_WAIT_S, POLL_S = 1.0, 0.05


class RvizComparison:
    """Publishes the frames camera_calibration/old and camera_calibration/new, and a view pyramid for each. Create it at
    the start of the program: RViz needs a moment to subscribe, and the program may exit after `show`.
    """

    def __init__(self) -> None:
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._markers = rospy.Publisher(TOPIC, MarkerArray, queue_size=1, latch=True)

    def show(self, old: np.ndarray | None, new: np.ndarray) -> None:
        """Shows the poses T_base_camera, shape (4, 4) [m], with or without an old one; waits a moment for RViz."""
        deadline = time.monotonic() + VIEWER_WAIT_S
        while not self._markers.get_num_connections() and time.monotonic() < deadline:
            time.sleep(POLL_S)
        poses = {"new": new} if old is None else {"old": old, "new": new}
        now = rospy.Time.now()
        frames = [stamped_transform(T, BASE, f"camera_calibration/{name}", now) for name, T in poses.items()]
        self._static.sendTransform(frames)
        self._markers.publish(MarkerArray([_marker(i, name, now) for i, name in enumerate(poses)]))


def _marker(number: int, name: str, stamp: rospy.Time) -> Marker:
    marker = Marker(id=number, ns=name, type=Marker.LINE_LIST, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = f"camera_calibration/{name}"
    marker.header.stamp = stamp
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(LINE_M, 0.0, 0.0)
    marker.color = ColorRGBA(*COLOURS[name], 1.0)
    corners = [Point(x * HALF_WIDTH_M, y * HALF_HEIGHT_M, DEPTH_M) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for i, corner in enumerate(corners):
        marker.points += [Point(), corner, corner, corners[(i + 1) % 4]]
    return marker
