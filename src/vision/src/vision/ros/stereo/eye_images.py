"""The pictures of both eyes from the camera's topics, always the newest: whatever comes while one is drawn is skipped.

Topics: rgb/image_raw, rgb/camera_info, and depth/image_raw in the colour camera's pixels.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from common.ros.images import camera_model_from_info, colour_from_image, depth_from_image
from vision.stereo.config import StereoViewConfig
from vision.stereo.image_age import PictureAge, age_text
from vision.stereo.view import EyePictures, StereoView

BUFFER_BYTES = 2**24
"""Room for many pictures: rospy drops all but the newest only among those that it has read."""
THROTTLE_S = 10.0


@dataclass(frozen=True, eq=False)
class Seen:
    """What the person sees now.

    Attributes:
        eyes: the pictures.
        view: that made them.
        age: since the picture came [s].
        new: whether this picture was not returned before.
        stamp: of the picture.
    """

    eyes: EyePictures
    view: StereoView
    age: float
    new: bool
    stamp: rospy.Time


class StereoPictures:
    """Takes pictures in and makes what each eye sees.

    Args:
        config: settings.
    """

    def __init__(self, config: StereoViewConfig) -> None:
        self._config = config
        self._arrival = threading.Condition()
        self._age = PictureAge()
        self._colour: tuple[Image, float] | None = None
        self._depth: Image | None = None
        self._info: CameraInfo | None = None
        self._view: StereoView | None = None
        self._made_for: tuple | None = None
        self._last: Seen | None = None
        self._subscribers: list[rospy.Subscriber] = []
        self._milliseconds = self._delay = 0.0
        self._drawn = 0
        rospy.Subscriber("rgb/camera_info", CameraInfo, self._take_info, queue_size=1)

    def listen_if(self, wanted: bool) -> None:
        """Subscribes to the pictures or lets them go: a camera takes none that nobody wants."""
        if wanted and not self._subscribers:
            topics = {"rgb/image_raw": self._take_colour}
            if self._config.depth:
                topics["depth/image_raw"] = self._take_depth
            self._subscribers = [
                rospy.Subscriber(name, Image, take, queue_size=1, buff_size=BUFFER_BYTES, tcp_nodelay=True)
                for name, take in topics.items()
            ]
        elif not wanted and self._subscribers:
            for subscriber in self._subscribers:
                subscriber.unregister()
            self._subscribers = []

    def wait(self, timeout: float) -> Seen | None:
        """Returns what the next picture shows; if none comes within `timeout` [s], the last one, marked if it is old.

        None: there was no picture yet.
        """
        with self._arrival:
            self._arrival.wait_for(lambda: self._colour is not None and self._info is not None, timeout)
            colour, depth, info = self._colour, self._depth, self._info
            if info is not None:
                self._colour = None
        if colour is not None and info is not None and self._age.is_new(colour[0].header.stamp.to_sec()):
            try:
                seen = self._make(colour[0], depth, info)
                self._age.shown(seen.stamp.to_sec(), colour[1])
                self._last = seen
                return seen
            except ValueError as error:
                rospy.logwarn_throttle(THROTTLE_S, f"A picture was not shown: {error}.")
        return self._aged()

    def diagnose(self) -> tuple[int, str, dict[str, object]]:
        """Returns level, sentence and values for common.ros.diagnostics."""
        values = {"drawn": self._drawn, "milliseconds": f"{self._milliseconds:.1f}", "delay": f"{self._delay:.3f}"}
        last = self._last
        if not self._subscribers:
            return DiagnosticStatus.OK, "Nobody looks.", values
        if last is None:
            missing = "camera_info" if self._info is None else "image_raw"
            return DiagnosticStatus.WARN, f"Waits for {rospy.resolve_name(f'rgb/{missing}')}.", values
        values["deep"] = last.eyes.deep
        age = self._age.age(time.monotonic())
        if age > self._config.age_after:
            return DiagnosticStatus.WARN, f"The picture that is shown is {age_text(age)}.", values
        if self._config.depth and not last.eyes.deep:
            topic = rospy.resolve_name("depth/image_raw")
            return DiagnosticStatus.WARN, f"Shows the same picture twice: no depth of its time on {topic}.", values
        return DiagnosticStatus.OK, "Shows pictures.", values

    def _take_info(self, message: CameraInfo) -> None:
        with self._arrival:
            self._info = message
            self._arrival.notify_all()

    def _take_colour(self, message: Image) -> None:
        with self._arrival:
            self._colour = message, time.monotonic()
            self._arrival.notify_all()

    def _take_depth(self, message: Image) -> None:
        with self._arrival:
            self._depth = message

    def _make(self, colour: Image, depth: Image | None, info: CameraInfo) -> Seen:
        started = time.perf_counter()
        picture = np.ascontiguousarray(colour_from_image(colour))
        view = self._for(info)
        eyes = view.eyes(picture, self._metres(depth, colour.header.stamp))
        self._drawn += 1
        self._milliseconds = 1e3 * (time.perf_counter() - started)
        self._delay = (rospy.Time.now() - colour.header.stamp).to_sec()
        return Seen(eyes, view, 0.0, True, colour.header.stamp)

    def _aged(self) -> Seen | None:
        last = self._last
        if last is None:
            return None
        age = self._age.age(time.monotonic())
        eyes = last.eyes.aged(age) if age > self._config.age_after else last.eyes
        return Seen(eyes, last.view, age, False, last.stamp)

    def _metres(self, depth: Image | None, stamp: rospy.Time) -> np.ndarray | None:
        """Returns the depth that belongs to a picture [m]; None if there is none of its time."""
        if depth is None or abs((depth.header.stamp - stamp).to_sec()) > self._config.depth_gap:
            return None
        return depth_from_image(depth)

    def _for(self, info: CameraInfo) -> StereoView:
        """Returns the view of this camera; a calibration may be replaced while the node runs."""
        made_for = (info.K, info.D, info.R, info.P, info.width, info.height)
        if self._view is None or made_for != self._made_for:
            self._view = StereoView(camera_model_from_info(info), self._config)
            self._made_for = made_for
        return self._view
