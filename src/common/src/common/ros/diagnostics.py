"""What a node lets others observe: its state and counters, and when it has finished with a frame."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import TimeReference

PERIOD_S = 0.5
STAGE_TIMES = "rig/stage_times"


class Diagnostics:
    """Publishes a node's state and counters on /diagnostics twice a second, under `name`.

    `read` returns (level, message, values): a DiagnosticStatus level, one sentence, and the counters.
    """

    def __init__(self, name: str, read: Callable[[], tuple[int, str, Mapping[str, object]]]) -> None:
        self._name, self._read = name, read
        self._publisher = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self._stop = threading.Event()
        threading.Thread(target=self._loop, name="diagnostics", daemon=True).start()
        rospy.on_shutdown(self._stop.set)

    def publish(self) -> None:
        """Publishes the present state."""
        level, message, values = self._read()
        status = DiagnosticStatus(level=level, name=self._name, message=message)
        status.values = [KeyValue(key, str(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = rospy.Time.now()
        self._publisher.publish(array)

    def _loop(self) -> None:
        while not self._stop.wait(PERIOD_S):
            try:
                self.publish()
            except rospy.ROSException:
                if not rospy.core.is_shutdown_requested():  # then the topic closes under this thread
                    raise


class StageTimes:
    """Publishes when a stage from hand to wire has finished with a frame, so that delays can be measured from outside.

    Every stage publishes on one topic: `header.stamp` is the stamp of the tracking frame (its time of receipt),
    `time_ref` the time at which the stage passed its result on, `source` the name of the stage.
    """

    def __init__(self, stage: str) -> None:
        self._stage = stage
        self._publisher = rospy.Publisher(STAGE_TIMES, TimeReference, queue_size=100)

    def done(self, frame_stamp: rospy.Time) -> None:
        """Publishes that the stage has just passed on its result for the frame with this stamp."""
        message = TimeReference(time_ref=rospy.Time.now(), source=self._stage)
        message.header.stamp = frame_stamp
        self._publisher.publish(message)
