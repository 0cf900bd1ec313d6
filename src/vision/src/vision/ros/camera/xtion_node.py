"""The Xtion Pro Live as a node, with the topics of openni2_camera (`common.ros.rgbd_topics`)."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common.camera_model import CameraModel, from_calibration
from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.images import metres_from_millimetres
from common.ros.params import private_config, private_values
from common.ros.rgbd_topics import RgbdTopics
from vision.camera.frames import CameraFramesConfig, depth_in_rgb
from vision.camera.openni_camera import Frame, OpenniCamera, XtionConfig
from vision.camera.registration import Registration, millimetres_from_metres

CALIBRATIONS = ("rgb_calibration", "depth_calibration")
FRAMES = "frames"
SERIAL = "serial"
"""Private parameter that the node writes: the device's serial number, for whoever keeps something about this camera."""

TIMEOUT_S = 0.5
SILENCE_S = 2.0
"""After so long without a picture the camera is opened anew."""
RETRY_PERIOD_S = 2.0


class Xtion:
    """Publishes what the camera sends; opens it again when it was lost.

    Args:
        config: of the device.
        rgb, depth: intrinsics of the two cameras.
        T_rgb_depth: pose of the depth camera in the colour camera, shape (4, 4) [m].

    Raises:
        DeviceError: the library is missing.
    """

    def __init__(self, config: XtionConfig, rgb: CameraModel, depth: CameraModel, T_rgb_depth: np.ndarray) -> None:
        self._config = config
        self._registration = Registration(rgb, depth, T_rgb_depth)
        self._camera = OpenniCamera(config, rgb, depth)
        self._topics = RgbdTopics(rgb, depth)
        self._offset = rospy.Duration.from_sec(config.time_offset)
        self._trouble = "The camera is not open yet."
        self._pictures = self._losses = 0

    def run(self) -> None:
        """Publishes until ROS shuts down.

        Raises:
            DeviceError: there is no camera at the start.
        """
        try:
            self._connect()
            Diagnostics("camera", self._diagnose)
            while not rospy.is_shutdown():
                try:
                    self._publish_until_lost()
                except DeviceError as error:
                    self._lost(error)
        finally:
            self._camera.disconnect()

    def _connect(self) -> None:
        name = self._camera.connect()
        self._trouble = ""
        serial = self._camera.serial()
        rospy.set_param(rospy.resolve_name(f"~{SERIAL}"), serial)
        rospy.loginfo("The camera %s, serial number %s, sends pictures.", name, serial or "unknown")

    def _publish_until_lost(self) -> None:
        last = time.monotonic()
        while not rospy.is_shutdown():
            frame = self._camera.read(TIMEOUT_S)
            if frame is not None:
                last = time.monotonic()
                self._publish(frame)
            elif time.monotonic() - last > SILENCE_S:
                raise DeviceError(f"The camera has sent nothing for {SILENCE_S:g} s.")

    def _lost(self, error: DeviceError) -> None:
        """Waits until the camera is there again."""
        self._losses += 1
        rospy.logerr("%s", error)
        self._trouble = str(error)
        while not rospy.is_shutdown():
            try:
                return self._connect()
            except DeviceError as again:
                self._trouble = str(again)
                rospy.rostime.wallsleep(RETRY_PERIOD_S)

    def _publish(self, frame: Frame) -> None:
        stamp = rospy.Time.now() + self._offset
        if frame.name == "rgb":
            self._publish_as("rgb", lambda: frame.picture, stamp)
        elif self._config.depth_registration:
            self._publish_as("depth_registered", lambda: frame.picture, stamp)
        else:
            self._publish_as("depth", lambda: frame.picture, stamp)
            self._publish_as("depth_registered", lambda: self._registered(frame.picture), stamp)
        self._pictures += 1

    def _publish_as(self, name: str, picture: Callable[[], np.ndarray], stamp: rospy.Time) -> None:
        """Publishes a picture, which is made only if somebody wants it."""
        if self._topics.wanted(name):
            self._topics.publish(name, picture(), stamp)
        self._topics.publish_info(name, stamp)

    def _registered(self, depth: np.ndarray) -> np.ndarray:
        """Returns depth in the pixels of the raw colour picture, as the device itself could give it instead."""
        registration = self._registration
        return millimetres_from_metres(registration.as_taken(registration.register(metres_from_millimetres(depth))))

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"pictures": self._pictures, "losses": self._losses}
        if self._trouble:
            return DiagnosticStatus.ERROR, self._trouble, values
        return DiagnosticStatus.OK, "Pictures come.", values


def main() -> None:
    """Runs the node with its private parameters."""
    config = private_config(XtionConfig, others=(*CALIBRATIONS, FRAMES, SERIAL))
    rgb, depth = (from_calibration(private_values().get(name, {})) for name in CALIBRATIONS)
    frames = private_config(CameraFramesConfig, FRAMES)
    Xtion(config, rgb, depth, depth_in_rgb(frames)).run()
