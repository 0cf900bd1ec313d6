"""Publishes the true pose of the camera in the simulated world, the result of a perfect calibration.

Static transform kuka/base_frame -> camera_link. It replaces the node camera_place, which publishes the same transform
from a calibration; start only one of the two.
"""

from __future__ import annotations

import numpy as np
import rospy
import tf2_ros

from common.frames import BASE, CAMERA_LINK
from common.poses import inverse, pose
from common.ros.conversions import stamped_transform
from common.ros.params import private_config
from common.rotations import rotation_from_zyx
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import WorldConfig
from rig_simulation.ros.polling import poll
from rig_simulation.world.model import camera_link_pose
from rig_simulation.world.scene import scene_from

NAME = "camera_truth"
PERIOD_S, TIMEOUT_S = 1.0, 2.0


def camera_in_base(fields: dict) -> np.ndarray:
    """Returns the pose of camera_link in the arm's base, shape (4, 4), from the world's answer to `scene`."""
    roll, pitch, yaw = np.radians(fields["mounting"])
    T_world_base = pose(rotation_from_zyx(yaw, pitch, roll))
    return inverse(T_world_base) @ camera_link_pose(scene_from(fields["scene"]).camera)


def main() -> None:
    """Runs the node with its private parameters: publishes at the start and after each change of the scene."""
    config = private_config(WorldConfig)
    client = ControlClient(config.host, config.port, TIMEOUT_S)
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    published: np.ndarray | None = None

    def publish() -> None:
        nonlocal published
        T_base_camera = camera_in_base(client.ask("scene"))
        if published is None or not np.array_equal(published, T_base_camera):
            published = T_base_camera
            broadcaster.sendTransform(stamped_transform(T_base_camera, BASE, CAMERA_LINK, rospy.Time.now()))

    poll(publish, PERIOD_S)
