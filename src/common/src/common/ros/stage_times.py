"""When each stage from hand to wire finished with a frame, so that delays can be measured from outside.

Every stage publishes on one topic: `header.stamp` is the stamp of the tracking frame (its time of receipt), `time_ref`
the time at which the stage passed its result on, `source` the name of the stage.
"""

from __future__ import annotations

import rospy
from sensor_msgs.msg import TimeReference

TOPIC = "rig/stage_times"


class StageTimes:
    """Publishes when a stage has finished with a frame."""

    def __init__(self, stage: str) -> None:
        self._stage = stage
        self._publisher = rospy.Publisher(TOPIC, TimeReference, queue_size=100)

    def done(self, frame_stamp: rospy.Time) -> None:
        """Publishes that the stage has just passed on its result for the frame with this stamp."""
        message = TimeReference(time_ref=rospy.Time.now(), source=self._stage)
        message.header.stamp = frame_stamp
        self._publisher.publish(message)
