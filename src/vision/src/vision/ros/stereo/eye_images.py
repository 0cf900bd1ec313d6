"""Makes the eye images from the newest camera images: images that arrive while one is drawn are skipped. Topics:

rgb/image_raw, rgb/camera_info, and depth/image_raw in the colour camera's pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from common import clock
from common.ros.images import camera_model_from_info, colour_from_image, depth_from_image
from common.ros.on_demand import OnDemand
from vision.ros.camera.rgbd_pairs import BUFFER_BYTES
from vision.stereo.view import EyeImages, ImageAge, StereoView, StereoViewConfig, age_text

THROTTLE_S = 10.0


@dataclass(frozen=True, eq=False)
class ShownView:
    """What the operator sees now."""

    eyes: EyeImages  # the images
    view: StereoView  # the view that made them
    new: bool  # whether this image was not returned before
    stamp: rospy.Time  # time stamp of the image


class StereoImageSource:
    """Receives camera images and makes the eye images."""

    def __init__(self, config: StereoViewConfig) -> None:
        self._config = config
        self._arrival = clock.Condition()
        self._age = ImageAge()
        self._colour: tuple[Image, float] | None = None
        self._depth: Image | None = None
        self._info: CameraInfo | None = None
        self._view: StereoView | None = None
        self._made_for: tuple | None = None
        self._last: ShownView | None = None
        self.subscribe = OnDemand(self._subscribed)
        self._milliseconds = self._delay = 0.0
        self._drawn = 0
        rospy.Subscriber("rgb/camera_info", CameraInfo, self._on_info, queue_size=1)

    def _subscribed(self) -> list[rospy.Subscriber]:
        options = {"queue_size": 1, "buff_size": BUFFER_BYTES, "tcp_nodelay": True}
        topics = [("rgb/image_raw", self._on_colour), ("depth/image_raw", self._on_depth)]
        used = topics if self._config.depth else topics[:1]
        return [rospy.Subscriber(name, Image, callback, **options) for name, callback in used]

    def wait(self, timeout: float) -> ShownView | None:
        """Returns the next view, after `timeout` [s] the last one, marked if it is old; None: no image arrived yet."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._colour is not None and self._info is not None, timeout)
            colour, depth, info = self._colour, self._depth, self._info
            if info is not None:
                self._colour = None
        if colour is not None and info is not None and self._age.is_new(colour[0].header.stamp.to_sec()):
            try:
                self._last = self._make(colour[0], depth, info)
                self._age.shown(self._last.stamp.to_sec(), colour[1])
                return self._last
            except ValueError as error:
                rospy.logwarn_throttle(THROTTLE_S, f"Dropped an image: {error}.")
        if self._last is None:
            return None
        age = self._age.age(clock.monotonic())
        eyes = self._last.eyes.aged(age) if age > self._config.age_after else self._last.eyes
        return replace(self._last, eyes=eyes, new=False)

    def diagnose(self) -> tuple[int, str, dict[str, object]]:
        """Returns level, sentence and values for common.ros.diagnostics."""
        values = {"drawn": self._drawn, "milliseconds": f"{self._milliseconds:.1f}", "delay": f"{self._delay:.3f}"}
        last = self._last
        if not self.subscribe.subscribers:
            return DiagnosticStatus.OK, "Nobody is watching.", values
        if last is None:
            missing = "camera_info" if self._info is None else "image_raw"
            return DiagnosticStatus.WARN, f"Waits for {rospy.resolve_name(f'rgb/{missing}')}.", values
        values["deep"] = last.eyes.deep
        age = self._age.age(clock.monotonic())
        if age > self._config.age_after:
            return DiagnosticStatus.WARN, f"The image on screen is {age_text(age)}: is the camera running?", values
        if self._config.depth and not last.eyes.deep:
            topic = rospy.resolve_name("depth/image_raw")
            return DiagnosticStatus.WARN, f"Shows the same image twice: no depth of its time on {topic}.", values
        return DiagnosticStatus.OK, "Shows images.", values

    def _on_info(self, message: CameraInfo) -> None:
        with self._arrival:
            self._info = message
            self._arrival.notify_all()

    def _on_colour(self, message: Image) -> None:
        with self._arrival:
            self._colour = message, clock.monotonic()
            self._arrival.notify_all()

    def _on_depth(self, message: Image) -> None:
        with self._arrival:
            self._depth = message

    def _make(self, colour: Image, depth: Image | None, info: CameraInfo) -> ShownView:
        started = perf_counter()
        image = np.ascontiguousarray(colour_from_image(colour))
        made_for = (info.K, info.D, info.R, info.P, info.width, info.height)
        if self._view is None or made_for != self._made_for:  # a calibration may change while the node runs
            self._view = StereoView(camera_model_from_info(info), self._config)
            self._made_for = made_for
        stamp = colour.header.stamp
        fresh = depth is not None and abs((depth.header.stamp - stamp).to_sec()) <= self._config.depth_gap
        eyes = self._view.eyes(image, depth_from_image(depth) if fresh else None)
        self._drawn += 1
        self._milliseconds = 1e3 * (perf_counter() - started)
        self._delay = (rospy.Time.now() - stamp).to_sec()
        return ShownView(eyes, self._view, True, stamp)
