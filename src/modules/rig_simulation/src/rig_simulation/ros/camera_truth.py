"""Publishes where the camera of the simulated world truly is: what a perfect calibration would say.

Static transform kuka/base_frame -> camera_link. It takes the place of the node camera_place, which publishes the same
transform from a calibration: one of the two, never both.
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import rospy
import tf2_ros

from common.config import integer, parse, text
from common.errors import DeviceError
from common.poses import inverse, pose
from common.ros.conversions import stamped_transform
from common.rotations import rotation_from_zyx
from rig_simulation.control_port import ControlClient
from rig_simulation.ros.silence import Silence
from rig_simulation.world.model import camera_link_pose
from rig_simulation.world.scene import scene_from

NAME = "camera_truth"
BASE_FRAME, CAMERA_FRAME = "kuka/base_frame", "camera_link"
DEFAULTS = {"host": "127.0.0.1", "port": 30021}
PERIOD_S, TIMEOUT_S = 1.0, 2.0


@dataclasses.dataclass(frozen=True)
class CameraTruthConfig:
    """Private parameters of the node."""

    host: str = text(doc="address of the simulated world")
    port: int = integer(low=1, high=65535, doc="its control port")


def camera_in_base(fields: dict) -> np.ndarray:
    """Returns the pose of camera_link in the arm's base, shape (4, 4), from the world's answer to `scene`."""
    roll, pitch, yaw = np.radians(fields["mounting"])
    T_world_base = pose(rotation_from_zyx(yaw, pitch, roll))
    return inverse(T_world_base) @ camera_link_pose(scene_from(fields["scene"]).camera)


def main() -> None:
    """Runs the node with its private parameters: publishes at the start and after each change of scene."""
    config = parse(CameraTruthConfig, {**DEFAULTS, **rospy.get_param("~", {})}, prefix="~")
    client = ControlClient(config.host, config.port, TIMEOUT_S)
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    published: np.ndarray | None = None
    silence = Silence()
    while not rospy.is_shutdown():
        try:
            T_base_camera = camera_in_base(client.ask("scene"))
        except DeviceError as error:
            silence.goes_on(error)
        else:
            silence.is_over()
            if published is None or not np.array_equal(published, T_base_camera):
                published = T_base_camera
                broadcaster.sendTransform(stamped_transform(T_base_camera, BASE_FRAME, CAMERA_FRAME, rospy.Time.now()))
        time.sleep(PERIOD_S)
