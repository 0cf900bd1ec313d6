"""The newest depth image of a camera, or why it cannot be used."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from common import clock
from common.camera_model import CameraModel, camera_model_from_info
from common.ros.compressed_images import depth_topic
from common.ros.images import depth_from_image
from common.ros.inputs import NodeInputs
from grasping.pipeline.settings import InputConfig


class DepthImage(NamedTuple):
    """A depth image, or why it is of no use."""

    header: Header  # of the message
    depth: np.ndarray | None  # shape (h, w), float32 [m], not finite = none; None with a reason
    camera: CameraModel | None  # that took it; None with a reason
    reason: str  # a clause; empty if the image is of use


class DepthStream:
    """Takes depth images and gives the newest away, once."""

    def __init__(self, config: InputConfig) -> None:
        self._config = config
        self._new = clock.Condition()
        self._image: Image | None = None
        self._info: CameraInfo | None = None
        self._started = clock.monotonic()
        self.received = self.skipped = 0
        self.inputs = NodeInputs([config.depth_topic], once=[config.info_topic], silent=config.silence)
        self.inputs.subscribe(config.info_topic, CameraInfo, self._take_info)
        self.inputs.subscribe(*depth_topic(config.depth_topic, self._take))

    def newest(self, timeout: float) -> DepthImage | None:
        """Returns the newest image that was not given away yet; waits up to `timeout` [s], then returns None."""
        with self._new:
            self._new.wait_for(lambda: self._image is not None or rospy.is_shutdown(), timeout)
            image, self._image = self._image, None
        return None if image is None else self._read(image)

    def silence(self) -> str:
        """Returns that images or their camera_info do not come, a clause; empty while they do."""
        missing = self.inputs.missing()
        waits = clock.monotonic() - self._started <= self._config.silence
        return f"the depth camera is silent: {missing}" if missing and not waits else ""

    def _take(self, message: Image) -> None:
        with self._new:
            self.received += 1
            self.skipped += self._image is not None
            self._image = message
            self._new.notify()

    def _take_info(self, message: CameraInfo) -> None:
        self._info = message

    def _read(self, image: Image) -> DepthImage:
        def refused(reason: str) -> DepthImage:
            return DepthImage(image.header, None, None, reason)

        if image.header.stamp.is_zero():
            return refused("the depth image has no stamp")
        age = (rospy.Time.now() - image.header.stamp).to_sec()
        if abs(age) > self._config.max_age:
            return refused(f"the depth image is {abs(age):.1f} s {'old' if age > 0.0 else 'in the future'}")
        if self._info is None:
            return refused(f"no camera_info has come on {rospy.resolve_name(self._config.info_topic)}")
        try:
            depth, camera = depth_from_image(image), camera_model_from_info(self._info, (image.width, image.height))
        except ValueError as error:
            return refused(f"the depth image is invalid: {error}")
        return DepthImage(image.header, depth, camera, "")
