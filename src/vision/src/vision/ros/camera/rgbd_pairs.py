"""Pairs of colour and depth images from the same time, with their cameras and the pose of one camera in the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import message_filters
import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from common import clock
from common.camera_model import CameraModel
from common.ros.conversions import pose_from_transform
from common.ros.images import camera_model_from_info, colour_from_image, depth_from_image
from common.ros.node import while_running
from common.ros.on_demand import OnDemand

BUFFER_BYTES = 2**24  # room for several images: rospy drops old images only after it has read them
QUEUE = 5
THROTTLE_S = 10.0


@dataclass(frozen=True, eq=False)
class RgbdPair:
    """A pair of images."""

    header: Header  # of the colour image
    colour: np.ndarray  # RGB, shape (height, width, 3), uint8
    depth: np.ndarray  # raw, shape (height, width), float32 [m], NaN where unknown
    rgb_info: CameraInfo  # camera_info of both
    depth_info: CameraInfo  # camera_info of both
    T_rgb_depth: np.ndarray  # pose of the depth camera in the colour camera, shape (4, 4) [m]

    @property
    def rgb(self) -> CameraModel:
        """The colour camera; raises ValueError if it is not calibrated."""
        return camera_model_from_info(self.rgb_info)

    @property
    def depth_camera(self) -> CameraModel:
        """The depth camera; raises ValueError if it is not calibrated."""
        return camera_model_from_info(self.depth_info)


class _Synchronizer(message_filters.ApproximateTimeSynchronizer):
    """Pairs images by time. Empties its queues when stamps go back, as when a recording restarts: the later messages
    would otherwise stay in the queue for ever and push the new ones out.
    """

    def add(self, msg, my_queue, my_queue_index=None):
        with self.lock:
            if my_queue and msg.header.stamp < max(my_queue):
                for queue in self.queues:
                    queue.clear()
        super().add(msg, my_queue, my_queue_index)


class RgbdPairs:
    """Subscribes to rgb/image_raw and depth/image_raw, and to their camera_info. `on_pair` gets each pair whose images
    are at most `slop` [s] apart; if it raises ValueError, the pair is dropped and the reason logged. `pairs` counts
    them; `waits_for` says what is missing, as a noun, and is empty while pairs arrive.
    """

    def __init__(self, on_pair: Callable[[RgbdPair], None], slop: float) -> None:
        self._on_pair, self._slop = on_pair, slop
        self._infos: dict[str, CameraInfo] = {}
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer)
        self._lock = clock.Lock()
        self.subscribe = OnDemand(self._subscribed)
        self.pairs = 0
        self.waits_for = "images"
        for name in ("rgb", "depth"):
            rospy.Subscriber(f"{name}/camera_info", CameraInfo, self._on_info, callback_args=name, queue_size=1)

    def _subscribed(self) -> list[message_filters.Subscriber]:
        topics = [f"{name}/image_raw" for name in ("rgb", "depth")]
        images = [message_filters.Subscriber(t, Image, queue_size=1, buff_size=BUFFER_BYTES) for t in topics]
        _Synchronizer(images, QUEUE, self._slop).registerCallback(self._on_images)
        return images

    def _on_info(self, message: CameraInfo, name: str) -> None:
        self._infos[name] = message

    def _on_images(self, rgb: Image, depth: Image) -> None:
        if not self._lock.acquire(blocking=False):
            return  # the previous pair is still being processed
        try:
            with while_running():
                self._process(rgb, depth)
        except ValueError as error:
            self.waits_for = f"usable images: {error}"
            rospy.logwarn_throttle(THROTTLE_S, f"Dropped a pair of images: {error}.")
        finally:
            self._lock.release()

    def _process(self, rgb: Image, depth: Image) -> None:
        missing = [rospy.resolve_name(f"{name}/camera_info") for name in ("rgb", "depth") if name not in self._infos]
        if missing:
            self._wait(" and ".join(missing))
            return
        try:
            found = self._buffer.lookup_transform(rgb.header.frame_id, depth.header.frame_id, rospy.Time(0))
        except tf2_ros.TransformException:
            self._wait(f"the frame {depth.header.frame_id} in {rgb.header.frame_id}")
            return
        T_rgb_depth = pose_from_transform(found.transform)
        infos = self._infos["rgb"], self._infos["depth"]
        self._on_pair(RgbdPair(rgb.header, colour_from_image(rgb), depth_from_image(depth), *infos, T_rgb_depth))
        self.pairs += 1
        self.waits_for = ""

    def _wait(self, what: str) -> None:
        self.waits_for = what
        rospy.loginfo_throttle(THROTTLE_S, f"Waiting for {what}.")
