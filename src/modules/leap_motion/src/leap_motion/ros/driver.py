"""The node leap_driver: every frame of the Leap service becomes a message on leap_motion/leap_device."""

from __future__ import annotations

import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.node import run
from common.ros.params import private_config
from common.ros.publishing import DirectPublisher
from leap_motion.client import LeapClient, LeapLink, LeapStatus
from leap_motion.msg import Human
from leap_motion.ros.human import FrameMessage
from leap_motion.ros.parameters import DriverConfig

POLL_S = 0.1
REMIND_S = 10.0
SETTLED_S = 0.3


class LinkReport:
    """Logs a state of the link that lasts, and again every 10 s while no frames come."""

    def __init__(self, client: LeapClient) -> None:
        self._client = client
        self._status: LeapStatus | None = None
        self._logged: LeapStatus | None = None
        self._changed_at = self._logged_at = 0.0

    def update(self) -> None:
        """Logs the state if it is due."""
        status, now = self._client.status, time.monotonic()
        if status != self._status:
            self._status, self._changed_at = status, now
        streaming = status.link is LeapLink.STREAMING
        due = status != self._logged or (not streaming and now - self._logged_at > REMIND_S)
        if due and now - self._changed_at > SETTLED_S:
            self._logged, self._logged_at = status, now
            log = rospy.loginfo if streaming or status.link is LeapLink.CONNECTING else rospy.logwarn
            log("%s", status.sentence)

    def diagnostics(self) -> tuple[int, str, dict[str, object]]:
        """Returns level, sentence and counts for /diagnostics."""
        status, counts = self._client.status, self._client.counts
        values = {
            "state": status.link.value,
            "service_version": status.service,
            "frames_received": counts.received,
            "frames_superseded": counts.superseded,
            "frames_dropped": sum(counts.dropped.values()),
            "reconnects": max(0, counts.connections - 1),
            "hands_dropped": sum(counts.hands_dropped.values()),
            **{f"dropped: {reason}": count for reason, count in (counts.dropped + counts.hands_dropped).items()},
        }
        level = DiagnosticStatus.OK if status.link is LeapLink.STREAMING else DiagnosticStatus.ERROR
        return level, status.sentence, values


def start() -> None:
    """Reads the parameters and publishes until ROS shuts down.

    Raises:
        ConfigError: a parameter is unknown or out of range.
    """
    config = private_config(DriverConfig)
    rospy.loginfo("Leap service %s:%d, orientation %s.", config.host, config.port, config.orientation)
    publisher = DirectPublisher("leap_motion/leap_device", Human, queue_size=1)
    stage = StageTimes("leap_motion")
    client = LeapClient(config.host, config.port, clock=rospy.Time.now)
    report = LinkReport(client)
    Diagnostics("leap_motion", report.diagnostics)
    try:
        while not rospy.is_shutdown():
            report.update()
            received = client.next_frame(POLL_S)
            if received is not None:
                publisher.publish(FrameMessage(received.frame, received.stamp, config.orientation))
                stage.done(received.stamp)
    finally:
        client.close()


def main() -> None:
    """Entry point of the script."""
    run("leap_driver", start)
