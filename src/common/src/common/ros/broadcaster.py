"""Broadcasting on tf."""

from __future__ import annotations

import rospy
import tf2_ros
from geometry_msgs.msg import TransformStamped


class FreshBroadcaster(tf2_ros.TransformBroadcaster):
    """Broadcasts no frame twice with one stamp, as of a camera whose images repeat: each listener warns of each."""

    def __init__(self) -> None:
        super().__init__()
        self._stamps: dict[str, rospy.Time] = {}  # of the newest transform of each frame

    def sendTransform(self, transform: TransformStamped | list[TransformStamped]) -> None:
        fresh = []
        for one in transform if isinstance(transform, list) else [transform]:
            if self._stamps.get(one.child_frame_id) != one.header.stamp:
                self._stamps[one.child_frame_id] = one.header.stamp
                fresh.append(one)
        if fresh:
            super().sendTransform(fresh)
