"""What a node lets others observe: its state and counters, and when it has finished with a frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Header

from common.ros.node import repeat
from common.ros.params import arm_frames
from common.ros.publishing import DirectPublisher

PERIOD_S = 0.5
STAGE_TIMES = "rig/stage_times"
RECEIVED = "received"  # the stage that ends when a frame has come in


class Diagnostics:
    """Publishes a node's state and counters on /diagnostics twice a second. They stand there under `name`; where there
    are two arms, behind the prefix of this node's arm, or of that in the namespace `of`. `read` returns (level,
    message, values): a DiagnosticStatus level, one sentence, and the counters. Raises ConfigError if the parameter
    tf_prefix is invalid."""

    def __init__(self, name: str, read: Callable[[], tuple[int, str, Mapping[str, object]]], of: str = "") -> None:
        self._name = arm_frames(of)(name)
        self._read = read
        self._publisher = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        repeat(self.publish, PERIOD_S, "diagnostics")

    def publish(self) -> None:
        level, message, values = self._read()
        status = DiagnosticStatus(level=level, name=self._name, message=message)
        status.values = [KeyValue(key, str(value)) for key, value in values.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = rospy.Time.now()
        self._publisher.publish(array)


class StageTimes:
    """Publishes when a stage from hand to wire has finished with a frame, so that delays can be measured from outside.
    Every stage publishes on one topic: `header.stamp` is the stamp of the tracking frame, `time_ref` the time at which
    the stage passed its result on, `source` the name of the stage. RECEIVED is the first one: when the frame came in,
    which may be later than its stamp. The messages come up to BURST_S later, several at once: to write and to read each
    of them alone would delay the frames. `of`: the namespace of the arm with a slash, in a node for several."""

    def __init__(self, stage: str, of: str = "") -> None:
        burst_s = 0.1
        self._stage = stage
        self._publisher = DirectPublisher(of + STAGE_TIMES, TimeReference, queue_size=100)
        self._done: deque[tuple[str, rospy.Time, rospy.Time]] = deque()
        repeat(self._publish, burst_s, "stage times")

    def done(self, frame_stamp: rospy.Time, received: rospy.Time | None = None) -> None:
        """Notes that the stage has just passed on its result for the frame with this stamp; the first stage also says
        when the frame was received."""
        if self._publisher.get_num_connections():
            if received is not None:
                self._done.append((RECEIVED, frame_stamp, received))
            self._done.append((self._stage, frame_stamp, rospy.Time.now()))

    def _publish(self) -> None:
        while self._done:
            stage, stamp, at = self._done.popleft()
            self._publisher.publish(TimeReference(Header(0, stamp, ""), at, stage))
