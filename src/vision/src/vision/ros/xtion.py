"""The Xtion Pro Live as a node, with the topics of openni2_camera (`common.ros.rgbd_topics`)."""

from __future__ import annotations

import time

import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common.camera_model import CameraModel, from_calibration
from common.config import parse
from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.rgbd_topics import RgbdTopics
from vision.openni_camera import Frame, OpenniCamera, XtionConfig

CALIBRATIONS = ("rgb_calibration", "depth_calibration")
TIMEOUT_S = 0.5
SILENCE_S = 2.0
"""After so long without a picture the camera is opened anew."""
RETRY_PERIOD_S = 2.0


class Xtion:
    """Publishes what the camera sends; opens it again when it was lost.

    Args:
        config: of the device.
        rgb, depth: intrinsics of the two cameras.

    Raises:
        DeviceError: the library is missing.
    """

    def __init__(self, config: XtionConfig, rgb: CameraModel, depth: CameraModel) -> None:
        self._config = config
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
        rospy.loginfo("The camera %s sends pictures.", name)

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
        registered = frame.name == "depth" and self._config.depth_registration
        name = "depth_registered" if registered else frame.name
        stamp = rospy.Time.now() + self._offset
        if self._topics.wanted(name):
            self._topics.publish(name, frame.picture, stamp)
        self._topics.publish_info(name, stamp)
        self._pictures += 1

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"pictures": self._pictures, "losses": self._losses}
        if self._trouble:
            return DiagnosticStatus.ERROR, self._trouble, values
        return DiagnosticStatus.OK, "Pictures come.", values


def main() -> None:
    """Runs the node with its private parameters."""
    values = rospy.get_param("~", {})
    config = parse(XtionConfig, values, prefix="~", others=CALIBRATIONS)
    rgb, depth = (from_calibration(values.get(name)) for name in CALIBRATIONS)
    Xtion(config, rgb, depth).run()
