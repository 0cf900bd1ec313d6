"""Pairs of colour and depth images from the same time, with their cameras and the pose of one camera in the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import message_filters
import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from common import clock
from common.camera_model import CameraModel, camera_model_from_info
from common.plausible import check_near
from common.ros.conversions import pose_from_transform
from common.ros.images import colour_from_image, depth_from_image
from common.ros.inputs import NodeInputs, clause
from common.ros.node import while_running
from common.ros.on_demand import OnDemand

CAMERAS = ("rgb", "depth")


@dataclass(frozen=True, eq=False)
class RgbdPair:
    """A pair of images."""

    header: Header  # of the colour image
    colour: np.ndarray  # RGB, shape (height, width, 3), uint8
    depth: np.ndarray  # raw, shape (height, width), float32 [m], NaN where unknown
    rgb: CameraModel  # the colour camera
    depth_camera: CameraModel
    T_rgb_depth: np.ndarray  # pose of the depth camera in the colour camera, shape (4, 4) [m]


class _Synchronizer(message_filters.ApproximateTimeSynchronizer):
    """Pairs images by time. Empties its queues when stamps go back, as when a recording restarts: the later messages
    would otherwise stay in the queue for ever and push the new ones out."""

    def add(self, msg, my_queue, my_queue_index=None):
        with self.lock:
            if my_queue and msg.header.stamp < max(my_queue):
                for queue in self.queues:
                    queue.clear()
        super().add(msg, my_queue, my_queue_index)


class RgbdPairs:
    """Subscribes to rgb/image_raw and depth/image_raw, and to their camera_info. `on_pair` gets each pair whose images
    are at most `slop` [s] apart; it raises ValueError if it makes nothing of it. `inputs` says what is wrong with them;
    `pairs` counts what was made."""

    def __init__(self, on_pair: Callable[[RgbdPair], None], slop: float) -> None:
        self._on_pair, self._slop = on_pair, slop
        self._infos: dict[str, CameraInfo] = {}
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)
        self._lock = clock.Lock()
        self._images, infos = ([f"{name}/{kind}" for name in CAMERAS] for kind in ("image_raw", "camera_info"))
        self.inputs = NodeInputs(self._images, infos, slop)
        self.subscribe = OnDemand(self._subscribed)
        self.pairs = 0
        for name, topic in zip(CAMERAS, infos):
            self.inputs.subscribe(topic, CameraInfo, partial(self._infos.__setitem__, name))

    def _subscribed(self) -> list[rospy.Subscriber]:
        queue = 5
        self.inputs.restart()
        filters = [message_filters.SimpleFilter() for _ in CAMERAS]
        _Synchronizer(filters, queue, self._slop).registerCallback(self._on_images)
        return [self.inputs.subscribe(t, Image, each.signalMessage) for t, each in zip(self._images, filters)]

    def _on_images(self, rgb: Image, depth: Image) -> None:
        """Passes a pair on; the synchronizer must not see an exception, which would leave it locked."""
        if len(self._infos) < len(CAMERAS) or not self._lock.acquire(blocking=False):
            return  # the previous pair is still being processed
        try:
            with while_running():
                self._on_pair(self._pair(rgb, depth))
                self.pairs += 1
                self.inputs.done()
        except ValueError as error:
            self.inputs.refused(error)
        finally:
            self._lock.release()

    def _pair(self, rgb: Image, depth: Image) -> RgbdPair:
        """Returns the pair of two images; raises ValueError if they cannot be used."""
        cameras = [
            camera_model_from_info(self._infos[name], (image.width, image.height))
            for name, image in zip(CAMERAS, (rgb, depth))
        ]
        T_rgb_depth = self._pose(rgb.header.frame_id, depth.header.frame_id)
        return RgbdPair(rgb.header, colour_from_image(rgb), depth_from_image(depth), *cameras, T_rgb_depth)

    def _pose(self, rgb: str, depth: str) -> np.ndarray:
        """Returns the pose of one frame in the other, shape (4, 4) [m]; raises ValueError if tf has none."""
        baseline_m = 1.0  # most between both cameras
        if not (rgb and depth):
            raise ValueError("the images come without a frame in their headers")
        try:
            T = pose_from_transform(self._buffer.lookup_transform(rgb, depth, rospy.Time(0)).transform)
        except tf2_ros.TransformException as error:
            raise ValueError(f"tf does not know the frame {depth!r} in {rgb!r}: {clause(error)}") from None
        try:
            return check_near(T, baseline_m)
        except ValueError as error:
            raise ValueError(f"the pose of {depth!r} in {rgb!r} is wrong: {error}") from None
