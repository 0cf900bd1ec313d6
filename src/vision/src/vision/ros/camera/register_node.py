"""The node register_rgbd: depth in the colour camera's pixels, and a coloured point cloud; and its start program.

It replaces the nodelets of image_proc and depth_image_proc on the same topics: rgb/image_rect_color, and under
depth_registered: sw_registered/image_rect_raw (16UC1, mm), sw_registered/image_rect (32FC1, m),
sw_registered/camera_info and points. Without subscribers it computes nothing and does not subscribe to the camera. The
start program prefers the nodelets. They need their plugin descriptions, which Debian ships in development packages;
without a description the nodelet manager would only report that the class does not exist.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from time import perf_counter
from xml.etree import ElementTree

import cv2
import numpy as np
import rospkg
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField

from common import clock
from common.camera_model import CameraModel, same_camera
from common.ros.diagnostics import Diagnostics
from common.ros.images import camera_info_message, image_message
from common.ros.node import run
from common.ros.params import private_config
from vision.camera.registration import POINT, PairsConfig, Registration, millimetres_from_metres
from vision.ros.camera.rgbd_pairs import RgbdPair, RgbdPairs

REGISTERED = "depth_registered/sw_registered"
NEEDED = dict(image_proc="libimage-proc-dev", depth_image_proc="libdepth-image-proc-dev", nodelet="libnodeletlib-tools")
"""ROS packages, and the Debian packages that contain them completely; `nodelet` has the manager and no nodelets."""


class RegisterNode:
    """Publishes the outputs that have subscribers."""

    def __init__(self, config: PairsConfig) -> None:
        self._registration: Registration | None = None
        self._made_for: tuple[CameraModel, CameraModel, np.ndarray] | None = None
        self._milliseconds = 0.0
        self._rectified = rospy.Publisher("rgb/image_rect_color", Image, queue_size=1)
        self._raw = rospy.Publisher(f"{REGISTERED}/image_rect_raw", Image, queue_size=1)
        self._metric = rospy.Publisher(f"{REGISTERED}/image_rect", Image, queue_size=1)
        self._info = rospy.Publisher(f"{REGISTERED}/camera_info", CameraInfo, queue_size=1)
        self._points = rospy.Publisher("depth_registered/points", PointCloud2, queue_size=1)
        self._outputs = (self._rectified, self._raw, self._metric, self._info, self._points)
        self._pairs = RgbdPairs(self._on_pair, config.slop)
        Diagnostics("register_rgbd", self._diagnose)

    def run(self) -> None:
        """Subscribes to the camera while the node has subscribers, until ROS shuts down."""
        listeners_period_s = 0.2
        while not rospy.is_shutdown():
            self._pairs.subscribe(self._wanted())
            clock.sleep(listeners_period_s)

    def _wanted(self) -> bool:
        return any(publisher.get_num_connections() for publisher in self._outputs)

    def _on_pair(self, pair: RgbdPair) -> None:
        started = perf_counter()
        registration = self._for(pair)
        header, wants_cloud = pair.header, self._points.get_num_connections() > 0
        if self._info.get_num_connections():
            self._info.publish(camera_info_message(registration.camera, header.frame_id, header.stamp))
        if wants_cloud or self._rectified.get_num_connections():
            rectified = registration.rectify(pair.colour)
            if self._rectified.get_num_connections():
                self._rectified.publish(image_message(rectified, "rgb8", header.frame_id, header.stamp))
        if wants_cloud or self._raw.get_num_connections() or self._metric.get_num_connections():
            registered = registration.register(pair.depth)
            if self._raw.get_num_connections():
                raw = millimetres_from_metres(registered)
                self._raw.publish(image_message(raw, "16UC1", header.frame_id, header.stamp))
            if self._metric.get_num_connections():
                self._metric.publish(image_message(registered, "32FC1", header.frame_id, header.stamp))
            if wants_cloud:
                self._points.publish(cloud_message(registration.cloud(registered, rectified), header))
            if np.isnan(registered).all():
                raise ValueError(_why_empty(pair))
        self._milliseconds = 1e3 * (perf_counter() - started)

    def _for(self, pair: RgbdPair) -> Registration:
        """Returns the registration of these cameras; a calibration may change while the node runs."""
        rgb, depth, T = made_for = pair.rgb, pair.depth_camera, pair.T_rgb_depth
        last = self._made_for
        same = last and same_camera(rgb, last[0]) and same_camera(depth, last[1]) and np.array_equal(T, last[2])
        if self._registration is None or not same:
            self._registration, self._made_for = Registration(*made_for), made_for
        return self._registration

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {"pairs": self._pairs.pairs, "milliseconds": f"{self._milliseconds:.1f}"}
        if not self._wanted():
            return DiagnosticStatus.OK, "No subscribers.", values
        return (*self._pairs.inputs.status("Registers."), values)


def _why_empty(pair: RgbdPair) -> str:
    if not (pair.depth > 0.0).any():
        return "the depth image holds no reading"
    x, y, z = pair.T_rgb_depth[:3, 3]
    place = f"at x {x:.3g}, y {y:.3g}, z {z:.3g} m in {pair.header.frame_id}"
    return f"no reading of the depth image falls into the colour image: tf has the depth camera {place}"


def cloud_message(points, header) -> PointCloud2:
    """Returns the message of an array of POINT, shape (height, width)."""
    height, width = points.shape
    # Point clouds in ROS store rgb as an integer's bits in a float field.
    fields = [PointField(name, POINT.fields[name][1], PointField.FLOAT32, 1) for name in POINT.names]
    size = POINT.itemsize
    return PointCloud2(header, height, width, fields, False, size, width * size, points.tobytes(), False)


def main() -> None:
    """Runs the node until ROS shuts down."""
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    run("register_rgbd", lambda: RegisterNode(private_config(PairsConfig)).run())


def start() -> None:
    """Replaces the process by the chosen program; exits with 1 if that is not installed."""
    purpose = "Starts the nodelets of depth_image_proc that register depth to colour, or our own node."
    parser = argparse.ArgumentParser(prog="register_rgbd_start.py", description=purpose)
    text = "true: the nodelets; false: our own node; auto: the nodelets where they are installed (%(default)s)"
    parser.add_argument("--nodelets", choices=("auto", "true", "false"), default="auto", help=text)
    wanted = parser.parse_args(rospy.myargv()[1:]).nodelets
    missing = [] if wanted == "false" else missing_packages(rospkg.RosPack())
    if wanted == "true" and missing:
        needed = f"The nodelets need {', '.join(missing)}"
        sys.exit(f"register_rgbd: {needed}: install the packages, or use our own node with nodelets:=false.")
    if wanted == "false" or missing:
        main()
    else:
        os.environ["ROS_NAMESPACE"] = "/"
        os.execvp("roslaunch", ["roslaunch", "vision", "register_nodelets.launch"])


def missing_packages(packages: rospkg.RosPack) -> list[str]:
    """Returns the Debian packages that the nodelets lack; `packages` are those that ROS finds."""

    def complete(package: str) -> bool:
        try:
            folder = Path(packages.get_path(package))
            exports = ElementTree.parse(folder / "package.xml").findall("export/nodelet")
        except (rospkg.ResourceNotFound, OSError, ElementTree.ParseError):
            return False
        described = [Path(export.get("plugin", "").replace("${prefix}", str(folder))) for export in exports]
        return package == "nodelet" or (bool(described) and all(file.is_file() for file in described))

    return [debian for package, debian in NEEDED.items() if not complete(package)]
