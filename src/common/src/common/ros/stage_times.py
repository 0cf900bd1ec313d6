"""When each stage of the way from hand to wire finished with a frame, so that delays can be measured from outside.

Every stage publishes on one topic: `header.stamp` is the stamp of the tracking frame (the moment of its receipt),
`time_ref` the moment at which the stage had handed its result on, `source` the name of the stage.
"""

from __future__ import annotations

import rospy
from sensor_msgs.msg import TimeReference

TOPIC = "rig/stage_times"


class StageTimes:
    """Publishes when this stage was done with a frame."""

    def __init__(self, stage: str) -> None:
        self._stage = stage
        self._publisher = rospy.Publisher(TOPIC, TimeReference, queue_size=100)

    def done(self, frame_stamp: rospy.Time) -> None:
        """Says that the stage handed on, just now, what it made of the frame with this stamp."""
        message = TimeReference(time_ref=rospy.Time.now(), source=self._stage)
        message.header.stamp = frame_stamp
        self._publisher.publish(message)
