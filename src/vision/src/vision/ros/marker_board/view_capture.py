"""Captures a view: detections of the marker board by its corners, refined by all grey values of their images."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import cv2
import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import DEFAULT_FAMILY
from common.camera_model import CameraModel
from common.errors import ConfigError, DeviceError
from common.ros.images import camera_model_from_info, colour_from_image
from vision.calibration.acceptance import BoardDetection
from vision.marker_board.refinement import refined
from vision.ros.calibration.calibration_setup import CalibrationSetup
from vision.ros.camera.rgbd_pairs import BUFFER_BYTES
from vision.ros.marker_board.detections import POLL_S, BoardListener

IMAGES = "camera/rgb/image_raw"
CAMERA_INFO = "camera/rgb/camera_info"
INFO_WAIT_S = 10.0
VIEW_TIMEOUT_S = 6.0
LATE_S = 1.0
"""Maximum delay of an image behind its detection."""
BY_CORNERS, REFINED = "by the corners", "refined"


class ViewCapture:
    """Collects the detections of a view; `camera` is the model of the raw images.

    Args:
        setup: the marker board, and the number of detections in a view.
        listener: receives the detections by the corners.
        detector: name of the detector node.

    Raises:
        ConfigError: the pattern of a tag is unknown.
        DeviceError: the camera publishes no camera_info.
    """

    def __init__(self, setup: CalibrationSetup, listener: BoardListener, detector: str) -> None:
        self.camera = _camera()
        self._listener, self._count = listener, setup.limits.pictures
        self._lock = threading.Lock()
        self._images: dict[int, np.ndarray] = {}
        self._refiner = None
        if setup.limits.photometric:
            family = rospy.get_param(f"{detector}/tag_family", DEFAULT_FAMILY)
            try:
                self._refiner = PhotometricRefiner(family, setup.target)
            except ValueError as error:
                raise ConfigError([f"Cannot refine the marker board's pose: {error}."]) from None

    def capture(self) -> tuple[list[BoardDetection], str]:
        """Returns the detections from now on, fewer than a view needs after VIEW_TIMEOUT_S, and how they were made."""
        if self._refiner is None:
            return [detection for _, detection in self._listener.collect(self._count, VIEW_TIMEOUT_S)], BY_CORNERS
        with self._lock:
            self._images.clear()
        subscriber = rospy.Subscriber(IMAGES, Image, self._on_image, queue_size=self._count, buff_size=BUFFER_BYTES)
        try:
            self._wait_for(lambda: self._images)
            stamped = self._listener.collect(self._count, VIEW_TIMEOUT_S)
            self._wait_for(lambda: all(stamp.to_nsec() in self._images for stamp, _ in stamped))
        finally:
            subscriber.unregister()
        with self._lock:
            pairs = [(detection, self._images.get(stamp.to_nsec())) for stamp, detection in stamped]
        if any(image is None for _, image in pairs):
            reason = f"{BY_CORNERS}: their images did not arrive on {rospy.resolve_name(IMAGES)}"
            return [detection for detection, _ in pairs], reason
        try:
            detections, reason = refined(pairs, self.camera, self._refiner)
        except ValueError as error:
            detections, reason = [detection for detection, _ in pairs], str(error)
        return detections, f"{BY_CORNERS}: {reason}" if reason else REFINED

    def _wait_for(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + LATE_S
        while time.monotonic() < deadline:
            with self._lock:
                if condition():
                    return
            time.sleep(POLL_S)

    def _on_image(self, message: Image) -> None:
        try:
            grey = cv2.cvtColor(np.ascontiguousarray(colour_from_image(message)), cv2.COLOR_RGB2GRAY)
        except ValueError as error:
            rospy.logwarn_throttle(10.0, f"Dropped an image: {error}.")
            return
        with self._lock:
            self._images[message.header.stamp.to_nsec()] = grey


def _camera() -> CameraModel:
    try:
        return camera_model_from_info(rospy.wait_for_message(CAMERA_INFO, CameraInfo, INFO_WAIT_S))
    except rospy.ROSException:
        raise DeviceError(f"Nothing arrives on {rospy.resolve_name(CAMERA_INFO)}: is the camera running?") from None
    except ValueError as error:
        raise DeviceError(f"The camera's camera_info cannot be used: {error}. Calibrate the camera.") from None
