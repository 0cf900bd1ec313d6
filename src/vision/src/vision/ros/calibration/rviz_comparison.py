"""Shows an old and a new camera pose in RViz, as frames and as markers."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.frames import BASE
from common.ros.conversions import stamped_transform
from common.ros.publishing import DirectPublisher
from common.ros.service_calls import MasterLost, ask_master

TOPIC = "camera_calibration/markers"
COLOURS = {"old": (0.55, 0.55, 0.55), "new": (0.1, 0.7, 0.2)}


class RvizComparison:
    """Publishes the frames camera_calibration/old and camera_calibration/new, and a view pyramid for each. Create it at
    the start of the program: RViz needs a moment to subscribe. The program may exit after `show`."""

    def __init__(self) -> None:
        # rospy's own publisher hands messages to threads, which an exit may leave no time.
        self._static = DirectPublisher("/tf_static", TFMessage, queue_size=1, latch=True)
        self._markers = DirectPublisher(TOPIC, MarkerArray, queue_size=1, latch=True)

    def show(self, old: np.ndarray | None, new: np.ndarray) -> None:
        """Shows the poses T_base_camera, shape (4, 4) [m], with or without an old one; waits until RViz is connected,
        if it has subscribed."""
        viewer_wait_s = 5.0
        poll_s = 0.05
        deadline = clock.monotonic() + viewer_wait_s
        while self._markers.get_num_connections() < self._viewers() and clock.monotonic() < deadline:
            clock.sleep(poll_s)
        poses = {"new": new} if old is None else {"old": old, "new": new}
        now = rospy.Time.now()
        frames = [stamped_transform(T, BASE, f"camera_calibration/{name}", now) for name, T in poses.items()]
        self._static.publish(TFMessage(frames))
        self._markers.publish(MarkerArray([_marker(i, name, now) for i, name in enumerate(poses)]))

    def _viewers(self) -> int:
        """Returns how many nodes subscribe to the markers, 0 where the master does not say."""
        try:
            _, subscribers, _ = ask_master("getSystemState") or ([], [], [])
        except MasterLost:
            return 0
        return len(dict(subscribers).get(self._markers.resolved_name, []))


def _marker(number: int, name: str, stamp: rospy.Time) -> Marker:
    depth_m = 0.15
    half_width_m = 0.09
    half_height_m = 0.066
    line_m = 0.004
    marker = Marker(id=number, ns=name, type=Marker.LINE_LIST, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = f"camera_calibration/{name}"
    marker.header.stamp = stamp
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(line_m, 0.0, 0.0)
    marker.color = ColorRGBA(*COLOURS[name], 1.0)
    corners = [Point(x * half_width_m, y * half_height_m, depth_m) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    for i, corner in enumerate(corners):
        marker.points += [Point(), corner, corner, corners[(i + 1) % 4]]
    return marker
