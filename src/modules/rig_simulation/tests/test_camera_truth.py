"""The node that publishes where the camera of the simulated world truly is."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from common import clock
from rig_simulation.control_port import ControlPort
from rig_simulation.files import read_scene
from rig_simulation.world.model import camera_link_pose
from rig_simulation.world.scene import scene_from

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros

from common.ros.conversions import pose_from_transform

pytestmark = pytest.mark.ros
SCENES = [
    {"mounting": mounting, "scene": read_scene("grasping"), "arms": arms}
    for mounting, arms in (([0, 0, 0], None), ([180, 0, 0], None), ([0, 0, 0], ["left", "right"]))
]


class World:
    """Answers `scene`."""

    def __init__(self, fields):
        self.fields = fields

    def scene(self):
        return self.fields


def truth(fields) -> np.ndarray:
    T = camera_link_pose(scene_from(fields["scene"]).camera)
    half_turn = np.diag([1.0, -1.0, -1.0, 1.0])
    return half_turn @ T if fields["mounting"][0] == 180 else T


@pytest.mark.parametrize("fields", SCENES, ids=["upright", "from a ceiling", "two arms"])
def test_the_pose_is_that_of_the_scene_and_follows_it(ros, fields):
    """It looks once a second."""
    parent = "world" if fields["arms"] else "kuka/base_frame"
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)

    def published():
        return pose_from_transform(buffer.lookup_transform(parent, "camera_link", rospy.Time(0)).transform)

    world = World(fields)
    with ControlPort({"scene": world.scene}) as port:
        node = ros.run("rig_simulation", "camera_truth_node.py", f"_port:={port.port}")
        clock.sleep(0.1)
        np.testing.assert_allclose(published(), truth(fields), atol=1e-9)
        world.fields = copy.deepcopy(fields)
        world.fields["scene"]["camera"]["position"][2] += 0.1
        clock.sleep(0.8)
        np.testing.assert_allclose(published(), truth(fields), atol=1e-9)
        clock.sleep(0.2)
        np.testing.assert_allclose(published(), truth(world.fields), atol=1e-9)
        assert node.poll() is None
