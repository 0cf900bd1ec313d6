"""The inputs of a node: subscribed, watched, and what is first wrong with them in log and diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common import clock
from common.frames import frame_name
from common.input_watch import OUTPUT_S, InputWatch
from common.ros.node import while_running
from common.sentences import without_numbers


class NodeInputs:
    """Subscribes to topics and watches them as InputWatch does, which has their resolved names. A callback that raises
    ValueError gave no output; its text is the reason. `done` tells that there was one."""

    def __init__(
        self, streams: Iterable[str], once: Iterable[str] = (), slop: float | None = None, silent: float = OUTPUT_S
    ) -> None:
        self._watch = InputWatch(map(rospy.resolve_name, streams), map(rospy.resolve_name, once), slop, silent)
        self.restart = self._watch.restart
        self._log = FaultLog()

    def subscribe(self, topic: str, kind: type, callback: Callable, queue_size: int = 1) -> rospy.Subscriber:
        """Subscribes to one of the topics. Frames in headers lose a leading slash."""
        # Room for several images: rospy drops all but the newest only among those that it has read.
        buffer_bytes = 2**24
        name = rospy.resolve_name(topic)

        def take(message) -> None:
            stamp, header = 0.0, getattr(message, "header", None)
            if header is not None:
                header.frame_id, stamp = frame_name(header.frame_id), header.stamp.to_sec()
            self._watch.came(name, clock.monotonic(), stamp)
            with while_running():
                try:
                    callback(message)
                except ValueError as error:
                    self.refused(error)

        return rospy.Subscriber(topic, kind, take, queue_size=queue_size, buff_size=buffer_bytes, tcp_nodelay=True)

    def refused(self, reason: Exception) -> None:
        self._watch.refused(clause(reason), clock.monotonic())

    def done(self) -> None:
        self._watch.done(clock.monotonic())

    def missing(self) -> str:
        """Returns which inputs do not come, a clause; empty if all do."""
        return self._watch.missing(clock.monotonic())

    def fault(self, logged: bool = True) -> str:
        """Returns why there is no output, a clause; empty if there is. A change of it that lasts is `logged`."""
        fault = self._watch.fault(clock.monotonic())
        return self._log(fault) if logged else fault

    def status(self, fine: str) -> tuple[int, str]:
        """Returns level and sentence for diagnostics: `fine`, or what is wrong."""
        fault = self.fault()
        return (DiagnosticStatus.WARN, f"{fault[0].upper()}{fault[1:]}.") if fault else (DiagnosticStatus.OK, fine)


def clause(error: Exception) -> str:
    """Returns what an exception says as one line without the full stop that those of tf2 have."""
    return " ".join(str(error).split()).rstrip(". ")


class FaultLog:
    """Called with the present fault, a clause or empty, as often as that is looked at: logs it once it has lasted, when
    more than its numbers has changed, and its end."""

    def __init__(self) -> None:
        self._kind = ""
        self._since = clock.monotonic()
        self._logged = ""

    def __call__(self, fault: str) -> str:
        settled_s = 0.4  # a fault that is shorter is not logged
        kind, now = without_numbers(fault), clock.monotonic()
        if kind != self._kind:
            self._kind, self._since = kind, now
        if kind != self._logged and now - self._since >= settled_s:
            self._logged = kind
            if fault:
                rospy.logwarn("No output: %s.", fault)
            else:
                rospy.loginfo("There is output again.")
        return fault
