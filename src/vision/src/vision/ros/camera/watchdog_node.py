"""Watches the camera: says within a second that it froze, vanished or sends garbage, and that it came back.

Stamps are taken from `rgb/camera_info` and `depth/camera_info`, which cost nothing. What the pictures show is looked at
only while somebody else takes them, so that the watch alone keeps no camera busy.
"""

from __future__ import annotations

import threading
import time
import zlib
from collections.abc import Callable

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from common.ros.diagnostics import Diagnostics
from common.ros.images import array_from_image
from common.ros.params import private_config
from vision.camera.stream_watch import Health, StreamWatch, WatchConfig

POLL_S = 0.1
LISTENERS_PERIOD_S = 1.0
STREAMS = {"rgb": "colour camera", "depth": "depth camera"}
LEVELS = {"waiting": DiagnosticStatus.WARN, "slow": DiagnosticStatus.WARN, "alive": DiagnosticStatus.OK}


class WatchedStream:
    """One camera's topics and the watch over them.

    Args:
        name: rgb or depth.
        config: limits.

    Attributes:
        garbled: pictures that nobody can work with.
    """

    def __init__(self, name: str, config: WatchConfig) -> None:
        self._name, self._looks_inside = name, config.pictures
        self._watch = StreamWatch(STREAMS[name], config)
        self._lock = threading.Lock()
        self._pictures: rospy.Subscriber | None = None
        self._said = "waiting"
        self._size: tuple[int, int] | None = None
        self.garbled = 0
        self.topic = rospy.resolve_name(f"{name}/image_raw")
        rospy.Subscriber(f"{name}/camera_info", CameraInfo, self._take_info, queue_size=1)

    def health(self) -> tuple[Health, float]:
        """Returns the present state and the pictures per second [Hz]."""
        with self._lock:
            now = time.monotonic()
            return self._watch.health(now), self._watch.rate(now)

    def report(self) -> bool:
        """Logs a change of state; returns whether there was one."""
        health, _ = self.health()
        if health.state == self._said:
            return False
        self._said = health.state
        (rospy.loginfo if health.usable else rospy.logwarn)("%s", health.sentence)
        return True

    def look_if(self, wanted: bool) -> None:
        """Takes the pictures while somebody else does."""
        if wanted and self._looks_inside and self._pictures is None:
            self._pictures = rospy.Subscriber(self.topic, Image, self._take_picture, queue_size=1, buff_size=2**22)
        elif not wanted and self._pictures is not None:
            self._pictures.unregister()
            self._pictures = None
            with self._lock:
                self._watch.look_away()

    def _take_info(self, message: CameraInfo) -> None:
        with self._lock:
            self._size = message.height, message.width
            self._watch.arrived(message.header.stamp.to_sec(), time.monotonic())

    def _take_picture(self, message: Image) -> None:
        try:
            picture = array_from_image(message)
            if self._size not in (None, picture.shape[:2]):
                raise ValueError(f"a picture of {message.width} x {message.height} is not of the size in camera_info")
        except ValueError as error:
            with self._lock:
                self.garbled += 1
                self._watch.looked_in_vain(str(error), time.monotonic())
            return
        filled = np.count_nonzero(picture) / picture.size if self._name == "depth" else 1.0
        digest = zlib.crc32(message.data)
        with self._lock:
            if self._pictures is not None:
                self._watch.looked(digest, time.monotonic(), filled)


class CameraWatchdog:
    """Watches both cameras."""

    def __init__(self, config: WatchConfig) -> None:
        self._streams = {name: WatchedStream(name, config) for name in STREAMS}
        self._diagnostics = Diagnostics("camera_watchdog", self._diagnose)

    def run(self) -> None:
        """Watches until ROS shuts down."""
        next_count = 0.0
        while not rospy.is_shutdown():
            if time.monotonic() >= next_count:
                next_count = time.monotonic() + LISTENERS_PERIOD_S
                taken = _topics_that_others_take()
                for stream in self._streams.values():
                    stream.look_if(taken(stream.topic))
            if any([stream.report() for stream in self._streams.values()]):
                self._diagnostics.publish()
            time.sleep(POLL_S)

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        level, sentences, values = DiagnosticStatus.OK, [], {}
        for name, stream in self._streams.items():
            health, rate = stream.health()
            values[name], values[f"{name}_rate"] = health.state, f"{rate:.1f}"
            values[f"{name}_garbled"] = stream.garbled
            sentences.append(health.sentence)
            level = max(level, LEVELS.get(health.state, DiagnosticStatus.ERROR))
        return level, " ".join(sentences), values


def _topics_that_others_take() -> Callable[[str], bool]:
    """Returns a function that says whether some other node subscribes to a topic; nobody does if the master is gone."""
    try:
        _, subscribers, _ = rospy.get_master().getSystemState()[2]
    except OSError:
        subscribers = []
    names = {topic: set(nodes) - {rospy.get_name()} for topic, nodes in subscribers}
    return lambda topic: bool(names.get(topic))


def main() -> None:
    """Runs the node with its private parameters."""
    CameraWatchdog(private_config(WatchConfig)).run()
