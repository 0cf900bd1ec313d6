"""The node camera_watchdog: reports within a second that the camera froze, vanished or sends garbage, and recovered. It
subscribes to `rgb/camera_info` and `depth/camera_info`, which are small. It checks the images only while another node
subscribes to them, so that the watchdog alone does not keep the camera busy."""

from __future__ import annotations

import zlib

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from common import clock
from common.ros.diagnostics import Diagnostics
from common.ros.images import array_from_image
from common.ros.params import private_config
from vision.camera.stream_watch import StreamHealth, StreamWatch, WatchConfig

STREAMS = {"rgb": "colour camera", "depth": "depth camera"}
LEVELS = {"waiting": DiagnosticStatus.WARN, "slow": DiagnosticStatus.WARN, "alive": DiagnosticStatus.OK}


class WatchedStream:
    """The topics of one camera, rgb or depth, and their watch; `garbled` counts the unusable images."""

    def __init__(self, name: str, config: WatchConfig) -> None:
        self._name, self._checks_content = name, config.pictures
        self._watch = StreamWatch(STREAMS[name], config)
        self._lock = clock.Lock()
        self._images: rospy.Subscriber | None = None
        self._reported = "waiting"
        self._size = (0, 0)
        self.garbled = 0
        self.topic = rospy.resolve_name(f"{name}/image_raw")
        rospy.Subscriber(f"{name}/camera_info", CameraInfo, self._on_info, queue_size=1)

    def report(self) -> tuple[StreamHealth, float, bool]:
        """Logs a change of state; returns the present state, the images per second [Hz], and whether it changed."""
        with self._lock:
            now = clock.monotonic()
            health, rate = self._watch.health(now), self._watch.rate(now)
            changed = health.state != self._reported
            if changed:  # under the lock, so that nobody shows a state before it is logged
                self._reported = health.state
                (rospy.loginfo if health.usable else rospy.logwarn)("%s", health.sentence)
        return health, rate, changed

    def subscribe(self, wanted: bool) -> None:
        """Subscribes to the images while another node does."""
        if wanted and self._checks_content and self._images is None:
            with self._lock:
                self._watch.expect_content(clock.monotonic())
            self._images = rospy.Subscriber(self.topic, Image, self._on_image, queue_size=1, buff_size=2**22)
        elif not wanted and self._images is not None:
            self._images.unregister()
            self._images = None
            with self._lock:
                self._watch.forget_content()

    def _on_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._size = message.height, message.width
            self._watch.add_stamp(message.header.stamp.to_sec(), clock.monotonic())

    def _on_image(self, message: Image) -> None:
        try:
            image = array_from_image(message)
            if self._size != image.shape[:2] and all(self._size):  # some drivers say no size
                raise ValueError(f"an image of {message.width} x {message.height} has not the size in camera_info")
        except ValueError as error:
            with self._lock:
                self.garbled += 1
                self._watch.add_garbled(str(error), clock.monotonic())
            return
        filled = np.count_nonzero(image) / image.size if self._name == "depth" else 1.0
        digest = zlib.crc32(message.data)
        with self._lock:
            if self._images is not None:
                self._watch.add_content(digest, clock.monotonic(), filled)


def main() -> None:
    """Watches both cameras until ROS shuts down."""
    poll_s = 0.1
    listeners_period_s = 1.0
    config = private_config(WatchConfig)
    streams = {name: WatchedStream(name, config) for name in STREAMS}
    diagnostics = Diagnostics("camera_watchdog", lambda: _diagnosis(streams))
    next_count = 0.0
    while not rospy.is_shutdown():
        if clock.monotonic() >= next_count:
            next_count = clock.monotonic() + listeners_period_s
            try:
                _, subscribers, _ = rospy.get_master().getSystemState()[2]
            except OSError:  # the master is gone
                subscribers = []
            wanted = {topic for topic, nodes in subscribers if set(nodes) - {rospy.get_name()}}
            for stream in streams.values():
                stream.subscribe(stream.topic in wanted)
        if any([stream.report()[2] for stream in streams.values()]):
            diagnostics.publish()
        clock.sleep(poll_s)


def _diagnosis(streams: dict[str, WatchedStream]) -> tuple[int, str, dict[str, object]]:
    level, sentences, values = DiagnosticStatus.OK, [], {}
    for name, stream in streams.items():
        health, rate, _ = stream.report()
        values.update({name: health.state, f"{name}_rate": f"{rate:.1f}", f"{name}_garbled": stream.garbled})
        sentences.append(health.sentence)
        level = max(level, LEVELS.get(health.state, DiagnosticStatus.ERROR))
    return level, " ".join(sentences), values
