"""The topics of an RGB-D camera, named as openni2_camera names them, in the node's namespace.

`rgb/image_raw` (rgb8); `depth/image_raw` (16UC1, mm, 0 = none) and `depth/image` (32FC1, m, NaN = none);
`depth_registered/image_raw` (16UC1, in the colour camera's pixels); `camera_info` beside each of the three images.
"""

from __future__ import annotations

import copy
from typing import Callable

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.camera_model import CameraModel
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL
from common.ros.images import camera_info_message, image_message, metres_from_millimetres

Outgoing = Callable[[Image], Image]
FRAMES = {"rgb": RGB_OPTICAL, "depth": DEPTH_OPTICAL, "depth_registered": RGB_OPTICAL}


class RgbdTopics:
    """Publishes images, each only while it has subscribers.

    Args:
        rgb, depth: intrinsics of the two cameras.
        outgoing: applied to each image message before it is published.
    """

    def __init__(self, rgb: CameraModel, depth: CameraModel, outgoing: Outgoing = lambda message: message) -> None:
        self._outgoing = outgoing
        models = {"rgb": rgb, "depth": depth, "depth_registered": rgb}
        self._raw = {name: rospy.Publisher(f"{name}/image_raw", Image, queue_size=1) for name in FRAMES}
        self._metric = rospy.Publisher("depth/image", Image, queue_size=1)
        self._infos = {name: rospy.Publisher(f"{name}/camera_info", CameraInfo, queue_size=1) for name in FRAMES}
        self._templates = {
            name: camera_info_message(models[name], frame, rospy.Time()) for name, frame in FRAMES.items()
        }

    def wanted(self, name: str) -> bool:
        """Returns whether rgb, depth or depth_registered has subscribers."""
        metric = name == "depth" and self._metric.get_num_connections() > 0
        return metric or self._raw[name].get_num_connections() > 0

    def publish(self, name: str, image: np.ndarray, stamp: rospy.Time) -> None:
        """Publishes an image: uint8 with three channels, red first, for rgb, else uint16 [mm]."""
        encoding = "rgb8" if name == "rgb" else "16UC1"
        if self._raw[name].get_num_connections():
            self._raw[name].publish(self._outgoing(image_message(image, encoding, FRAMES[name], stamp)))
        if name == "depth" and self._metric.get_num_connections():
            metric = image_message(metres_from_millimetres(image), "32FC1", DEPTH_OPTICAL, stamp)
            self._metric.publish(self._outgoing(metric))

    def publish_info(self, name: str, stamp: rospy.Time) -> None:
        """Publishes the camera_info of the image with this stamp."""
        info = copy.copy(self._templates[name])
        info.header = copy.copy(info.header)
        info.header.stamp = stamp
        self._infos[name].publish(info)

    def close(self) -> None:
        """Unregisters the topics."""
        for publisher in (*self._raw.values(), self._metric, *self._infos.values()):
            publisher.unregister()
