"""The node leap_driver: every frame of the Leap service becomes a message on leap_motion/leap_device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common import clock
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.node import run, while_running
from common.ros.params import private_config
from common.ros.publishing import DirectPublisher
from common.ros.simulated_devices import announce
from common.simulated import SIMULATED, WITHOUT_HARDWARE, doubt, refusal
from leap_motion.client import LeapClient, LeapLink, LeapStatus
from leap_motion.device_clock import DeviceClock
from leap_motion.frames import LeapFrame
from leap_motion.msg import Human, RawFrame
from leap_motion.registration import registered
from leap_motion.ros.human import FrameMessage
from leap_motion.ros.parameters import DriverConfig
from leap_motion.ros.registrations import TrackerRegistration, load, registration_file

RAW_FRAMES = 100  # wait for a recorder that is late
LEVELS = {LeapLink.STREAMING: DiagnosticStatus.OK, LeapLink.UNUSABLE: DiagnosticStatus.WARN}


class LinkReport:
    """Logs a state of the link that lasts, and again every 10 s while no frames come; `registration`, of that
    `name`, counts for the tracker that it was made with alone."""

    def __init__(self, client: LeapClient, registration: TrackerRegistration | None = None, name: str = "") -> None:
        self._client = client
        self._registration = registration
        self._name = name
        self._what = f"The registration {registration_file(name)}" if registration is not None else ""
        self._status: LeapStatus | None = None
        self._logged: LeapStatus | None = None
        self._changed_at = self._logged_at = 0.0

    def frame(self, frame: LeapFrame) -> LeapFrame | None:
        """Returns the frame in the axes of the registration; None while another tracker is plugged in."""
        if self._registration is None:
            return frame
        if self._refusal(self._client.status):
            return None
        return registered(frame, self._registration.T_desk_leap)

    def update(self) -> None:
        """Logs the state if it is due."""
        remind_s = 10.0
        settled_s = 0.3
        status, now = self._checked_status(), clock.monotonic()
        if status != self._status:
            self._status, self._changed_at = status, now
        streaming = status.link is LeapLink.STREAMING
        due = status != self._logged or (not streaming and now - self._logged_at > remind_s)
        if due and now - self._changed_at > settled_s:
            self._logged, self._logged_at = status, now
            fine = (streaming and not self._remark(status)) or status.link is LeapLink.CONNECTING
            log = rospy.loginfo if fine else rospy.logwarn
            absent = status.link is LeapLink.NO_SERVICE and not self._client.counts.connections
            log("%s", f"{status.sentence} {WITHOUT_HARDWARE}" if absent else status.sentence)

    def diagnostics(self) -> tuple[int, str, dict[str, object]]:
        status, counts = self._checked_status(), self._client.counts
        values = {
            "state": status.link.value,
            "service_version": status.service or "unknown",
            "serial": status.serial or "unknown",
            SIMULATED: str(status.simulated).lower(),
            "registration": self._name or "none",
            "frames_received": counts.received,
            "frames_superseded": counts.superseded,
            "frames_dropped": sum(counts.dropped.values()),
            "reconnects": max(0, counts.connections - 1),
            "hands_dropped": sum(counts.hands_dropped.values()),
            **{f"dropped: {reason}": count for reason, count in (counts.dropped + counts.hands_dropped).items()},
        }
        level = LEVELS.get(status.link, DiagnosticStatus.ERROR)
        return max(level, DiagnosticStatus.WARN) if self._remark(status) else level, status.sentence, values

    def _refusal(self, status: LeapStatus) -> str:
        """Returns why the registration does not count for the tracker that is plugged in, or ""."""
        of, again = self._registration, f"run rosrun leap_motion register_tracker.py {self._name}."
        if of is None:
            return ""
        if status.serial != of.serial:
            whose = f"The registration {self._name} is of the tracker {of.serial or 'unknown'}"
            found = f"{status.serial or 'an unknown one'} is plugged in"
            return f"{whose}, but {found}: its frames are unused. Plug in that one, or {again}"
        cure = f"The tracker's frames are unused: {again}"
        return refusal(self._what, of.simulated, status.simulated, cure)

    def _remark(self, status: LeapStatus) -> str:
        of = self._registration
        if of is None:
            return ""
        check = f"make sure that it is the one of the registration {self._name}, and has not been moved."
        which = "" if of.serial else f"It does not say which tracker is plugged in: {check}"
        return f"{which} {doubt(self._what, of.simulated, status.simulated)}".strip()

    def _checked_status(self) -> LeapStatus:
        status = self._client.status
        if self._registration is None or status.link is not LeapLink.STREAMING:
            return status
        why = self._refusal(status)
        if why:
            return replace(status, link=LeapLink.REFUSED, sentence=why)
        return replace(status, sentence=f"{status.sentence} {self._remark(status)}".strip())


def start(config: DriverConfig, pass_on: Callable[[FrameMessage], None] = lambda _: None) -> None:
    """Publishes until ROS shuts down; each message goes to `pass_on` as well. Raises RigError for a registration
    that cannot be used."""
    poll_s = 0.1
    registration = load(config.registration, clock.time()) if config.registration else None
    rospy.loginfo("Leap service %s:%d, orientation %s.", config.host, config.port, config.orientation)
    publisher = DirectPublisher("leap_motion/leap_device", Human, queue_size=1)
    raw = DirectPublisher("leap_motion/raw_frames", RawFrame, queue_size=RAW_FRAMES)
    stage = StageTimes("leap_motion")

    def publish_raw(text: str, received: rospy.Time) -> None:
        if raw.get_num_connections():
            with while_running():
                raw.publish(received, text)

    proof = {"code": config.code, "fingerprint": config.fingerprint, "trust_network": config.trust_network}
    options = {**proof, "tap": publish_raw, "runtime": clock, "bounds": config.bounds}
    client = LeapClient(config.host, config.port, clock=rospy.Time.now, **options)
    report, device_clock = LinkReport(client, registration, config.registration), DeviceClock()
    announced: rospy.Publisher | None = None
    Diagnostics("leap_motion", report.diagnostics)
    try:
        while not rospy.is_shutdown():
            report.update()
            if client.status.simulated and announced is None:
                announced = announce()
            elif announced is not None and not client.status.simulated:
                announced.unregister()
                announced = None
            received = client.next_frame(poll_s)
            if received is None:
                continue
            waited = device_clock.waited(received.frame.timestamp_us, received.stamp.to_sec())
            frame = report.frame(received.frame)
            if frame is not None:
                stamp = received.stamp - rospy.Duration.from_sec(waited)
                message = FrameMessage(frame, stamp, config.orientation)
                publisher.publish(message)
                stage.done(stamp, received.stamp)
                pass_on(message)
    finally:
        client.close()


def main() -> None:
    run("leap_driver", lambda: start(private_config(DriverConfig)))
