"""The driver node of the Xtion Pro Live, with the topics of openni2_camera (`common.ros.images`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticStatus

from common import clock
from common.camera_model import CameraModel, from_calibration
from common.errors import ConfigError, DeviceError
from common.input_watch import InputWatch
from common.ros.diagnostics import Diagnostics
from common.ros.images import RgbdTopics, metres_from_millimetres
from common.ros.params import private_config, private_values
from common.simulated import WITHOUT_HARDWARE, refusal, said_by
from vision.camera.frames import CameraFramesConfig, depth_in_rgb
from vision.camera.openni_camera import OpenniCamera, OpenniFrame, XtionConfig
from vision.camera.registration import Registration, millimetres_from_metres

CALIBRATIONS = ("rgb_calibration", "depth_calibration")
FRAMES = "frames"
SERIAL = "serial"  # private parameter that the node writes: the device's serial number, which calibrations store
STREAMS = {"rgb": "the camera's colour stream", "depth": "the camera's depth stream"}


class XtionNode:
    """Publishes the images of a camera with these intrinsics and T_rgb_depth, shape (4, 4) [m]; reopens it when it was
    lost. Raises DeviceError if the library is missing."""

    def __init__(self, config: XtionConfig, rgb: CameraModel, depth: CameraModel, T_rgb_depth: np.ndarray) -> None:
        self._config = config
        self._registration = Registration(rgb, depth, T_rgb_depth)
        self._camera = OpenniCamera(config, rgb, depth)
        self._topics = RgbdTopics(rgb, depth)
        self._offset = rospy.Duration.from_sec(config.time_offset)
        self._fault = "The camera is not open yet."
        self._images = self._losses = 0
        self._watch = InputWatch(STREAMS.values())

    def run(self) -> None:
        """Publishes until ROS shuts down; raises DeviceError if there is no camera at the start."""
        try:
            self._connect()
            Diagnostics("camera", self._diagnose)
            while not rospy.is_shutdown():
                try:
                    self._publish_until_lost()
                except DeviceError as error:
                    self._reconnect(error)
        finally:
            self._camera.disconnect()

    def _connect(self) -> None:
        name = self._camera.connect()
        self._fault = ""
        serial = self._camera.serial()
        rospy.set_param(rospy.resolve_name(f"~{SERIAL}"), serial)
        rospy.loginfo("The camera %s, serial number %s, sends images.", name, serial or "unknown")

    def _publish_until_lost(self) -> None:
        timeout_s = 0.5
        silence_s = 2.0  # after this time without an image of one of them the camera is reopened
        self._watch.restart()
        opened = clock.monotonic()
        while not rospy.is_shutdown():
            frame, now = self._camera.read(timeout_s), clock.monotonic()
            if frame is not None:
                self._watch.came(STREAMS[frame.name], now)
                self._publish(frame)
            missing = self._watch.missing(now, silence_s)
            if missing and now - opened > silence_s:
                raise DeviceError(f"{missing[0].upper()}{missing[1:]}; the camera is reopened.")

    def _reconnect(self, error: DeviceError) -> None:
        retry_period_s = 2.0
        self._losses += 1
        rospy.logerr("%s", error)
        self._fault = str(error)
        while not rospy.is_shutdown():
            try:
                return self._connect()
            except DeviceError as again:
                self._fault = str(again)
                rospy.rostime.wallsleep(retry_period_s)

    def _publish(self, frame: OpenniFrame) -> None:
        stamp = rospy.Time.now() + self._offset
        if frame.name == "rgb":
            self._publish_on("rgb", lambda: frame.image, stamp)
        elif self._config.depth_registration:
            self._publish_on("depth_registered", lambda: frame.image, stamp)
        else:
            self._publish_on("depth", lambda: frame.image, stamp)
            self._publish_on("depth_registered", lambda: self._registered(frame.image), stamp)
        self._images += 1

    def _publish_on(self, name: str, image: Callable[[], np.ndarray], stamp: rospy.Time) -> None:
        """Publishes an image, which is made only if the topic has subscribers."""
        if self._topics.wanted(name):
            self._topics.publish(name, image(), stamp)
        self._topics.publish_info(name, stamp)

    def _registered(self, depth: np.ndarray) -> np.ndarray:
        """Returns depth in the pixels of the raw colour image, as the device's own registration does."""
        registered = self._registration.register(metres_from_millimetres(depth))
        return millimetres_from_metres(self._registration.unrectified(registered))

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"pictures": self._images, "losses": self._losses}
        if self._fault:
            return DiagnosticStatus.ERROR, self._fault, values
        missing = self._watch.missing(clock.monotonic())
        if missing:
            return DiagnosticStatus.WARN, f"{missing[0].upper()}{missing[1:]}.", values
        return DiagnosticStatus.OK, "Images arrive.", values


def main() -> None:
    config = private_config(XtionConfig, others=(*CALIBRATIONS, FRAMES, SERIAL))
    given = [private_values().get(name, {}) for name in CALIBRATIONS]
    rgb, depth = map(from_calibration, given)
    for name, values in zip(CALIBRATIONS, given):
        why = refusal(f"The calibration {name}", said_by(values, f"~{name}/"), False, "Calibrate the real camera.")
        if why:
            raise ConfigError([why])
    frames = private_config(CameraFramesConfig, FRAMES)
    try:
        XtionNode(config, rgb, depth, depth_in_rgb(frames)).run()
    except DeviceError as error:
        raise DeviceError(f"{error} {WITHOUT_HARDWARE}") from error
