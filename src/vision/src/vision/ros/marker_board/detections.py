"""Receives the detections of the marker board from the detector node, and refines those of a view in their images."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image

from apriltag_ros.msg import AprilTagDetection, AprilTagDetectionArray
from apriltag_ros.photometric import PhotometricRefiner
from apriltag_ros.settings import DEFAULT_FAMILY, TagTarget
from common import clock
from common.camera_model import camera_model_from_info
from common.errors import ConfigError, DeviceError
from common.poses import pose
from common.ros.conversions import array
from common.ros.images import colour_from_image
from common.ros.inputs import NodeInputs
from common.ros.params import arm_frames
from common.rotations import rotation_from_quaternion
from vision.calibration.acceptance import BoardDetection, refined
from vision.ros.calibration.calibration_setup import CalibrationSetup

POLL_S = 0.05
IMAGES = "camera/rgb/image_raw"
CAMERA_INFO = "camera/rgb/camera_info"
VIEW_TIMEOUT_S = 6.0
DETECTOR_STATUS = "apriltag_ros"  # its name in /diagnostics
BY_CORNERS = "by the corners"


class BoardListener:
    """Subscribes to the detector of the marker board `target`. `on_detection` gets stamp, optical frame and detection
    for every image that shows the board. `frame` is the optical frame, empty before the first detection."""

    def __init__(
        self, target: TagTarget, on_detection: Callable[[rospy.Time, str, BoardDetection], None] | None = None
    ) -> None:
        self._ids = tuple(tag.id for tag in target.tags)
        self._on_detection = on_detection
        self._lock = clock.Lock()
        self._after = rospy.Time(0)
        self._detections: list[tuple[rospy.Time, BoardDetection]] = []
        self.frame = ""
        self._detector, self._detector_says, self._dropped = arm_frames()(DETECTOR_STATUS), "", ""
        self._inputs = NodeInputs(["tag_detections"])
        self._inputs.subscribe("tag_detections", AprilTagDetectionArray, self._on_message)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._on_diagnostics, queue_size=10)

    def fault(self) -> str:
        """Returns that the detector publishes nothing, and what it says itself, or that its newest detection is no
        pose; a clause, empty while there is nothing wrong."""
        missing = self._inputs.missing()
        says = f"; the detector says: {self._detector_says}" if missing and self._detector_says else ""
        return f"{missing}{says}" or self._dropped

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._detector:
                self._detector_says = status.message.rstrip(".")

    def collect(self, count: int, timeout: float) -> list[tuple[rospy.Time, BoardDetection]]:
        """Returns up to `count` detections in images from now on, with their stamps; fewer after `timeout` [s]."""
        with self._lock:
            self._after, self._detections = rospy.Time.now(), []
        deadline = clock.monotonic() + timeout
        while clock.monotonic() < deadline and not rospy.is_shutdown():
            with self._lock:
                if len(self._detections) >= count:
                    return self._detections[:count]
            clock.sleep(POLL_S)
        with self._lock:
            return list(self._detections)

    def _on_message(self, message: AprilTagDetectionArray) -> None:
        for entry in message.detections:
            if tuple(entry.id) != self._ids:
                continue
            try:
                detection = _detection(entry)
            except ValueError as error:
                self._dropped = f"a detection is dropped: {error}"
                rospy.logwarn_throttle(10.0, f"Dropped a detection: {error}.")
                continue
            self._dropped = ""
            with self._lock:
                self.frame = message.header.frame_id
                if message.header.stamp > self._after:
                    self._detections.append((message.header.stamp, detection))
            if self._on_detection is not None:
                self._on_detection(message.header.stamp, message.header.frame_id, detection)


class ViewCapture:
    """Collects the detections of a view by the corners, and refines them; `camera` is the model of the raw images.
    `detector` is the name of the detector node. Raises ConfigError if the pattern of a tag is unknown, and DeviceError
    if the camera publishes no camera_info."""

    def __init__(self, setup: CalibrationSetup, listener: BoardListener, detector: str) -> None:
        info_wait_s = 10.0
        try:
            info, size = rospy.wait_for_message(CAMERA_INFO, CameraInfo, info_wait_s), None
            if not (info.width and info.height):
                image = rospy.wait_for_message(IMAGES, Image, info_wait_s)
                size = image.width, image.height
            self.camera = camera_model_from_info(info, size)
        except rospy.ROSException:
            topics = " or ".join(map(rospy.resolve_name, (CAMERA_INFO, IMAGES)))
            raise DeviceError(f"Nothing arrives on {topics}: is the camera running?") from None
        except ValueError as error:
            raise DeviceError(f"The camera's camera_info cannot be used: {error}. Calibrate the camera.") from None
        self._listener, self._count = listener, setup.limits.pictures
        self._lock = clock.Lock()
        self._images: dict[int, np.ndarray] = {}
        self._inputs, self._refusal = NodeInputs([IMAGES]), ""
        self._refiner = None
        if setup.limits.photometric:
            family = rospy.get_param(f"{detector}/tag_family", DEFAULT_FAMILY)
            try:
                self._refiner = PhotometricRefiner(family, setup.target)
            except ValueError as error:
                raise ConfigError([f"Cannot refine the marker board's pose: {error}."]) from None

    def capture(self) -> tuple[list[BoardDetection], str]:
        """Returns the detections from now on, fewer than a view needs after VIEW_TIMEOUT_S, and how they were made.
        Raises ValueError if the detector publishes nothing."""
        if self._refiner is None:
            return [detection for _, detection in self._collected()], BY_CORNERS
        with self._lock:
            self._images.clear()
            self._refusal = ""
        subscriber = self._inputs.subscribe(IMAGES, Image, self._on_image, queue_size=self._count)
        try:
            self._wait_for(lambda: self._images)
            stamped = self._collected()
            self._wait_for(lambda: all(stamp.to_nsec() in self._images for stamp, _ in stamped))
        finally:
            subscriber.unregister()
        with self._lock:
            pairs = [(detection, self._images.get(stamp.to_nsec())) for stamp, detection in stamped]
        if any(image is None for _, image in pairs):
            missing = self._refusal or f"their images did not arrive on {rospy.resolve_name(IMAGES)}"
            reason = f"{BY_CORNERS}: {missing}"
            return [detection for detection, _ in pairs], reason
        try:
            detections, reason = refined(pairs, self.camera, self._refiner)
        except ValueError as error:
            detections, reason = [detection for detection, _ in pairs], str(error)
        return detections, f"{BY_CORNERS}: {reason}" if reason else "refined"

    def _collected(self) -> list[tuple[rospy.Time, BoardDetection]]:
        found = self._listener.collect(self._count, VIEW_TIMEOUT_S)
        silence = "" if found else self._listener.fault()
        if silence:
            raise ValueError(silence)
        return found

    def _wait_for(self, condition: Callable[[], object]) -> None:
        late_s = 1.0  # maximum delay of an image behind its detection
        deadline = clock.monotonic() + late_s
        while clock.monotonic() < deadline:
            with self._lock:
                if condition():
                    return
            clock.sleep(POLL_S)

    def _on_image(self, message: Image) -> None:
        try:
            grey = cv2.cvtColor(np.ascontiguousarray(colour_from_image(message)), cv2.COLOR_RGB2GRAY)
        except ValueError as error:
            self._refusal = str(error)
            return
        with self._lock:
            self._images[message.header.stamp.to_nsec()] = grey


def _detection(message: AprilTagDetection) -> BoardDetection:
    """Returns the detection; raises ValueError for numbers that are not a pose, or an empty covariance."""
    q = message.pose.pose.pose.orientation
    position, covariance = array(message.pose.pose.pose.position), np.reshape(message.pose.pose.covariance, (6, 6))
    if not (np.all(np.isfinite(position)) and np.all(np.isfinite(covariance))):
        raise ValueError("its numbers are not finite")
    if np.linalg.eigvalsh((covariance + covariance.T) / 2.0)[0] <= 0.0:
        raise ValueError("its covariance is not positive; use a detector that fills it in, such as ours")
    return BoardDetection(pose(rotation_from_quaternion([q.x, q.y, q.z, q.w]), position), covariance)
