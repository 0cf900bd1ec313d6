"""Writes the input and the grasps of the running node ggcnn to an image file and prints its speed.

Left the camera's depth image with the grippers as the camera sees them, right the network's image with its heat map.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path

import cv2
import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image

from common import clock
from common.camera_model import CameraModel, camera_model_from_info
from common.errors import RigError
from common.ros.conversions import pose_from_message
from common.ros.images import array_from_image, depth_from_image
from common.ros.node import run
from grasp_msgs.msg import GraspList
from grasping.pipeline import drawing


class NodeOutput:
    """The node's newest messages."""

    def __init__(self) -> None:
        self._lock = clock.Lock()
        self._depth: dict[rospy.Time, Image] = {}
        self._heat: dict[rospy.Time, Image] = {}
        self.lists: list[GraspList] = []
        self.latencies: list[float] = []
        self.milliseconds: dict[str, str] = {}
        newest = {"queue_size": 2, "buff_size": 2**24}
        rospy.Subscriber("camera/depth/image", Image, self._keep, callback_args=self._depth, **newest)
        rospy.Subscriber("ggcnn/img/heat_map", Image, self._keep, callback_args=self._heat, **newest)
        rospy.Subscriber("ggcnn/out/grasps", GraspList, self._take, queue_size=10, tcp_nodelay=True)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._take_diagnostics, queue_size=10)

    def newest(self) -> tuple[GraspList, np.ndarray, np.ndarray] | None:
        """Returns the newest grasps with the depth image and the heat map of the same moment."""
        with self._lock:
            for found in reversed(self.lists):
                stamp = found.header.stamp
                if found.grasps and stamp in self._depth and stamp in self._heat:
                    with contextlib.suppress(ValueError):  # a torn image; others follow
                        return found, depth_from_image(self._depth[stamp]), array_from_image(self._heat[stamp])
        return None

    def _keep(self, message: Image, into: dict) -> None:
        with self._lock:
            into[message.header.stamp] = message
            for old in sorted(into)[:-20]:
                del into[old]

    def _take(self, message: GraspList) -> None:
        with self._lock:
            self.latencies.append((rospy.Time.now() - message.header.stamp).to_sec())
            self.lists.append(message)

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "ggcnn":
                self.milliseconds = {v.key: v.value for v in status.values if v.key.startswith("ms_")}


def composed(found: GraspList, depth: np.ndarray, heat: np.ndarray, camera: CameraModel) -> np.ndarray:
    """Returns both images side by side, uint8, shape (480, 1120, 3) for a depth image of 640 x 480."""
    image = cv2.cvtColor(drawing.grey(depth), cv2.COLOR_GRAY2BGR)
    for i, grasp in reversed(list(enumerate(found.grasps))):
        colour, thickness = (drawing.OTHER, 1) if i else (drawing.DISC, 2)
        T, label = pose_from_message(grasp.pose_camera), f"{grasp.id}: {grasp.quality:.2f}"
        drawing.gripper(image, camera, T, grasp.width, label, colour, thickness)
    side = len(image)
    return np.hstack([image, cv2.resize(heat, (side, side), interpolation=cv2.INTER_AREA)])


def report(collected: NodeOutput) -> list[str]:
    """Returns what was measured, a line each."""
    stamps = np.array([found.header.stamp.to_sec() for found in collected.lists])
    latency = 1e3 * np.array(collected.latencies)
    best = collected.lists[-1].grasps
    return [
        f"{len(stamps)} images, {1.0 / np.diff(stamps).mean():.1f} a second",
        f"from the image's stamp to the grasps: median {np.median(latency):.0f} ms, "
        f"90 % within {np.percentile(latency, 90):.0f} ms",
        "in the node: " + ", ".join(f"{key[3:]} {value} ms" for key, value in collected.milliseconds.items()),
        "grasps: " + "; ".join(f"{g.id}: quality {g.quality:.2f}, opening {1e3 * g.width:.0f} mm" for g in best),
    ]


def _run() -> None:
    patience_s = 60.0
    poll_s = 0.05
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="image file that is written, such as grasp.png")
    parser.add_argument("--pictures", type=int, default=30, help="number of images to wait for, default 30")
    arguments = parser.parse_args(rospy.myargv()[1:])
    collected, deadline = NodeOutput(), clock.monotonic() + patience_s
    info = None
    while True:
        info = info or _camera_info()
        newest = collected.newest()
        if info is not None and newest is not None and len(collected.lists) >= arguments.pictures:
            break
        if rospy.is_shutdown() or clock.monotonic() > deadline:
            reasons = {found.reason for found in collected.lists[-5:]}
            raise RigError(f"No image with a grasp came within {patience_s:g} s: {'; '.join(reasons) or 'no answer'}.")
        clock.sleep(poll_s)
    try:
        camera = camera_model_from_info(info, newest[1].shape[::-1])
    except ValueError as error:
        raise RigError(f"No image with a grasp: {error}.") from None
    if not cv2.imwrite(str(arguments.file), composed(*newest, camera)):
        raise RigError(f"The image cannot be written to {arguments.file}.")
    sys.stdout.write("\n".join([*report(collected), f"{arguments.file} is written", ""]))


def _camera_info() -> CameraInfo | None:
    try:
        return rospy.wait_for_message("camera/depth/camera_info", CameraInfo, 1.0)
    except rospy.ROSException:
        return None


def main() -> None:
    run("grasp_picture", _run)
