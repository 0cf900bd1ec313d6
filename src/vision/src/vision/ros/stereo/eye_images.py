"""Makes the eye images from the newest camera images: images that arrive while one is drawn are skipped. Topics:
rgb/image_raw, rgb/camera_info, and depth/image_raw in the colour camera's pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image

from common import clock
from common.camera_model import CameraModel, camera_model_from_info, same_camera
from common.ros.images import colour_from_image, depth_from_image
from common.ros.inputs import NodeInputs
from common.ros.on_demand import OnDemand
from vision.stereo.view import EyeImages, ImageAge, StereoView, StereoViewConfig


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
        self._no_depth = ""  # why the newest depth image is of no use, a clause
        self._info: CameraInfo | None = None
        self._view: StereoView | None = None
        self._made_for: CameraModel | None = None
        self._last: ShownView | None = None
        self.subscribe = OnDemand(self._subscribed)
        self._milliseconds = self._delay = 0.0
        self._drawn = 0
        self._inputs = NodeInputs(["rgb/image_raw"], once=["rgb/camera_info"])
        self._inputs.subscribe("rgb/camera_info", CameraInfo, self._on_info)

    def _subscribed(self) -> list[rospy.Subscriber]:
        self._inputs.restart()
        topics = [("rgb/image_raw", self._on_colour), ("depth/image_raw", self._on_depth)]
        used = topics if self._config.depth else topics[:1]
        return [self._inputs.subscribe(name, Image, callback) for name, callback in used]

    def wait(self, timeout: float) -> ShownView | None:
        """Returns the next view, after `timeout` [s] the last one, marked if it is old; None: no image arrived yet."""
        with self._arrival:
            self._arrival.wait_for(lambda: self._colour is not None and self._info is not None, timeout)
            colour, info = self._colour, self._info
            if info is not None:
                self._colour = None
        if colour is not None and info is not None:
            try:
                if not self._age.is_new(colour[0].header.stamp.to_sec()):
                    raise ValueError("the camera repeats its image: the stamp does not change")
                self._last = self._make(colour[0], info)
                self._age.shown(self._last.stamp.to_sec(), colour[1])
                self._inputs.done()
                return self._last
            except ValueError as error:
                self._inputs.refused(error)
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
        level, sentence = self._inputs.status("Shows images.")
        if last is not None:
            values["deep"] = last.eyes.deep
        if level != DiagnosticStatus.OK or last.eyes.deep or not self._config.depth:
            return level, sentence, values
        topic, why = rospy.resolve_name("depth/image_raw"), self._no_depth
        return DiagnosticStatus.WARN, f"Shows the same image twice: {why or 'no depth of its time'} on {topic}.", values

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

    def _depth_at(self, stamp: rospy.Time, shape: tuple[int, int]) -> np.ndarray | None:
        """Returns the depth image of a time; None without one, and `_no_depth` says why it cannot be used."""
        message, self._no_depth = self._depth, ""
        if message is None or abs((message.header.stamp - stamp).to_sec()) > self._config.depth_gap:
            return None
        try:
            depth = depth_from_image(message)
            if depth.shape != shape:
                sizes = f"{message.width} x {message.height} pixels instead of {shape[1]} x {shape[0]}"
                raise ValueError(f"the depth image has {sizes}")
            return depth
        except ValueError as error:
            self._no_depth = str(error)
            return None

    def _make(self, colour: Image, info: CameraInfo) -> ShownView:
        started = perf_counter()
        image = np.ascontiguousarray(colour_from_image(colour))
        camera = camera_model_from_info(info, (colour.width, colour.height))
        if self._view is None or not same_camera(camera, self._made_for):  # a calibration may change meanwhile
            self._view, self._made_for = StereoView(camera, self._config), camera
        stamp = colour.header.stamp
        eyes = self._view.eyes(image, self._depth_at(stamp, image.shape[:2]))
        self._drawn += 1
        self._milliseconds = 1e3 * (perf_counter() - started)
        self._delay = (rospy.Time.now() - stamp).to_sec()
        return ShownView(eyes, self._view, True, stamp)
