"""The simulated RGB-D camera as a node, with the topics of openni2_camera (`common.ros.images`). It takes only images
with subscribers; all images of one moment have one stamp."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from time import perf_counter

import cv2
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Image

from common import clock
from common.camera_model import from_calibration
from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.images import RGBD_FRAMES, Outgoing, RgbdTopics
from common.ros.params import private_config, private_values
from common.ros.simulated_devices import announce
from common.simulated import SIMULATED
from rig_simulation.control_port import ControlClient, ControlPort
from rig_simulation.devices.camera.rgbd_camera import RgbdCamera
from rig_simulation.faults.camera import CAMERA_FAULTS, Exposure, ImageStream
from rig_simulation.faults.injection import Faults, parameter, switch_all
from rig_simulation.node_parameters import LOOPBACK, CameraConfig, ColourConfig, DepthConfig
from rig_simulation.world.model import WorldCopy

TIMEOUT_S = 1.0
SMOOTHING = 0.1  # weight of the newest value in the durations of the diagnostics
SERIAL = "serial"  # private parameter that the node writes, as the Xtion's driver does
SECTIONS = ("colour", "depth", "rgb_calibration", "depth_calibration")


class CameraNode:
    """Follows the world, takes images and publishes them; the argument of `open_topics` changes each outgoing image."""

    def __init__(
        self, config: CameraConfig, camera: RgbdCamera, open_topics: Callable[[Outgoing], RgbdTopics], faults: Faults
    ) -> None:
        self._period = 1.0 / config.rate
        self._world = WorldCopy(ControlClient(config.host, config.port, TIMEOUT_S))
        self._camera = camera
        self._open_topics = open_topics
        self._topics: RgbdTopics | None = None
        self._stream = ImageStream(faults)
        self._faults = faults
        self._trouble = f"The simulated world at {config.host}:{config.port} has not answered yet."
        self._published = self._overruns = 0
        self._milliseconds: dict[str, float] = {}
        Diagnostics("camera", self._diagnose)

    def run(self) -> None:
        """Publishes until ROS shuts down, while the world answers; raises DeviceError if this machine cannot render."""
        retry_period_s = 0.5
        idle_s = 1.0  # time between two looks at the world while nobody wants an image
        due = look = clock.monotonic()
        while not rospy.is_shutdown():
            wanted = [self._topics is not None and self._topics.wanted(name) for name in RGBD_FRAMES]
            try:
                new = False
                if any(wanted) or clock.monotonic() >= look:
                    new = self._world.follow()
                    look = clock.monotonic() + idle_s
            except DeviceError as error:
                if self._trouble != str(error):
                    rospy.logwarn("No images: %s", error)
                self._trouble = str(error)
                due = clock.monotonic() + retry_period_s
            else:
                if self._trouble:
                    rospy.loginfo("The simulated world answers; images are published.")
                    self._trouble = ""
                if new:
                    self._camera.attach(self._world.model)
                self._publish_next(wanted)
                due += self._period
                if due < clock.monotonic():
                    self._overruns += 1
                    due = clock.monotonic()
            clock.sleep(max(0.0, due - clock.monotonic()))

    def _publish_next(self, wanted: Iterable[bool]) -> None:
        topics = self._present_topics()
        if topics is None:
            return
        stamp = rospy.Time.now()
        exposure = self._stream.next(
            lambda: Exposure(self._camera.take(self._world.data, *wanted), stamp),
            stamp,
            clock.monotonic(),
        )
        if exposure is None:
            return
        started = perf_counter()
        images = exposure.images
        for name, image in zip(RGBD_FRAMES, (images.colour, images.depth, images.registered)):
            if image is not None:
                topics.publish(name, image, exposure.stamp)
            topics.publish_info(name, exposure.stamp)
        self._published += 1
        for stage, seconds in {**images.seconds, "publish": perf_counter() - started}.items():
            before = self._milliseconds.get(stage, 1000.0 * seconds)
            self._milliseconds[stage] = before + SMOOTHING * (1000.0 * seconds - before)

    def _present_topics(self) -> RgbdTopics | None:
        """Opens the topics; closes them and returns None while the driver restarts."""
        if self._faults.is_on("restarted"):
            if self._topics is not None:
                self._topics.close()
            self._topics = None
        elif self._topics is None:
            self._topics, self._stream = self._open_topics(self._garble), ImageStream(self._faults)
        return self._topics

    def _garble(self, message: Image) -> Image:
        for field, value in self._stream.garbled(message.height, message.width, message.step, message.data).items():
            setattr(message, field, value)
        return message

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        active = sorted(self._faults.active())
        values = {"pictures": self._published, "late_pictures": self._overruns, "faults": ", ".join(active)}
        values.update({f"{stage}_ms": f"{value:.1f}" for stage, value in list(self._milliseconds.items())})
        if self._trouble:
            return DiagnosticStatus.ERROR, self._trouble, values
        if active:
            return DiagnosticStatus.WARN, f"Faults are on: {', '.join(active)}.", values
        return DiagnosticStatus.OK, "Images are published.", values


def main() -> None:
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    config = private_config(CameraConfig, others=(*SECTIONS, SERIAL))
    announce()
    rospy.set_param(rospy.resolve_name(f"~{SERIAL}"), SIMULATED)
    rgb, depth = (from_calibration(private_values().get(name, {})) for name in ("rgb_calibration", "depth_calibration"))
    effects = private_config(ColourConfig, "colour"), private_config(DepthConfig, "depth")
    camera = RgbdCamera(rgb, depth, *effects, config.samples, config.seed)
    faults = Faults(CAMERA_FAULTS)
    switch_all(faults, parameter(config.fault, CAMERA_FAULTS, "~fault"))
    with ControlPort(faults.requests, LOOPBACK, config.control_port):
        try:
            CameraNode(config, camera, functools.partial(RgbdTopics, rgb, depth), faults).run()
        finally:
            camera.close()
