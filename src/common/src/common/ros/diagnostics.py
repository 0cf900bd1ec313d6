"""State and counters of a node on /diagnostics."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

PERIOD_S = 0.5


class Diagnostics:
    """Publishes a node's state and counters on /diagnostics twice a second.

    Args:
        name: name of the status, such as "kuka_control".
        read: returns (level, message, values): a DiagnosticStatus level, one sentence, and the counters.
    """

    def __init__(self, name: str, read: Callable[[], tuple[int, str, Mapping[str, object]]]) -> None:
        self._name = name
        self._read = read
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
