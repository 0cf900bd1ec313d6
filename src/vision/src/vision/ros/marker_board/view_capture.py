"""The panel in one view: by its corners, or refined by all grey values in the pictures that the corners come from."""

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
from vision.calibration.acceptance import Sight
from vision.marker_board.refinement import refined
from vision.ros.calibration.calibration_setup import CalibrationSetup
from vision.ros.marker_board.detections import POLL_S, PanelSights

PICTURES = "camera/rgb/image_raw"
CAMERA_INFO = "camera/rgb/camera_info"
BUFFER_BYTES = 2**24
INFO_WAIT_S = 10.0
VIEW_TIMEOUT_S = 6.0
LATE_S = 1.0
"""A picture may come so much later than what the detector found in it."""
BY_CORNERS, REFINED = "by the corners", "refined"


class PanelViewer:
    """Collects the sights of a view.

    Args:
        setup: the panel, and how many pictures make a view.
        sights: by the corners.
        detector: name of the detector node.

    Attributes:
        camera: that takes the raw pictures.

    Raises:
        ConfigError: the pattern of a tag is unknown.
        DeviceError: the camera does not describe itself.
    """

    def __init__(self, setup: CalibrationSetup, sights: PanelSights, detector: str) -> None:
        self.camera = _camera()
        self._sights, self._count = sights, setup.limits.pictures
        self._lock = threading.Lock()
        self._pictures: dict[int, np.ndarray] = {}
        self._refiner = None
        if setup.limits.photometric:
            family = rospy.get_param(f"{detector}/tag_family", DEFAULT_FAMILY)
            try:
                self._refiner = PhotometricRefiner(family, setup.target)
            except ValueError as error:
                raise ConfigError([f"The panel's pose cannot be refined: {error}."]) from None

    def look(self) -> tuple[list[Sight], str]:
        """Returns the sights of the panel from now on, fewer than a view needs if they do not come in time, and how
        they came about."""
        if self._refiner is None:
            return self._sights.collect(self._count, VIEW_TIMEOUT_S), BY_CORNERS
        with self._lock:
            self._pictures.clear()
        subscriber = rospy.Subscriber(PICTURES, Image, self._on_picture, queue_size=self._count, buff_size=BUFFER_BYTES)
        try:
            self._wait_for(lambda: self._pictures)
            stamped = self._sights.collect_stamped(self._count, VIEW_TIMEOUT_S)
            self._wait_for(lambda: all(stamp.to_nsec() in self._pictures for stamp, _ in stamped))
        finally:
            subscriber.unregister()
        with self._lock:
            pairs = [(sight, self._pictures.get(stamp.to_nsec())) for stamp, sight in stamped]
        sights = [sight for sight, _ in pairs]
        if any(picture is None for _, picture in pairs):
            return sights, f"{BY_CORNERS}: their pictures did not come on {rospy.resolve_name(PICTURES)}"
        try:
            sights, reason = refined(pairs, self.camera, self._refiner)
        except ValueError as error:
            reason = str(error)
        return sights, f"{BY_CORNERS}: {reason}" if reason else REFINED

    def _wait_for(self, condition: Callable[[], object]) -> None:
        deadline = time.monotonic() + LATE_S
        while time.monotonic() < deadline:
            with self._lock:
                if condition():
                    return
            time.sleep(POLL_S)

    def _on_picture(self, message: Image) -> None:
        try:
            grey = cv2.cvtColor(np.ascontiguousarray(colour_from_image(message)), cv2.COLOR_RGB2GRAY)
        except ValueError as error:
            rospy.logwarn_throttle(10.0, f"A picture was dropped: {error}.")
            return
        with self._lock:
            self._pictures[message.header.stamp.to_nsec()] = grey


def _camera() -> CameraModel:
    try:
        return camera_model_from_info(rospy.wait_for_message(CAMERA_INFO, CameraInfo, INFO_WAIT_S))
    except rospy.ROSException:
        raise DeviceError(f"There is no {rospy.resolve_name(CAMERA_INFO)}: is the camera running?") from None
    except ValueError as error:
        raise DeviceError(f"The camera's description is of no use: {error}.") from None
