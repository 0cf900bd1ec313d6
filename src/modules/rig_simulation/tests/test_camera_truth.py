"""The node that publishes where the camera of the simulated world truly is."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from rig_simulation.control_port import ControlPort
from rig_simulation.files import read_scene
from rig_simulation.world.model import camera_link_pose
from rig_simulation.world.scene import scene_from

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
def test_the_place_is_that_of_the_scene_and_follows_it(ros, wait_until, fields):
    import rospy
    import tf2_ros

    from common.ros.conversions import pose_from_transform

    parent = "world" if fields["arms"] else "kuka/base_frame"
    buffer = tf2_ros.Buffer()
    listener = tf2_ros.TransformListener(buffer)

    def published():
        if not buffer.can_transform(parent, "camera_link", rospy.Time(0)):
            return None
        return pose_from_transform(buffer.lookup_transform(parent, "camera_link", rospy.Time(0)).transform)

    world = World(fields)
    with ControlPort({"scene": world.scene}) as port:
        node = ros.run("rig_simulation", "camera_truth_node.py", f"_port:={port.port}")
        wait_until(lambda: published() is not None, 30.0, "the place")
        np.testing.assert_allclose(published(), truth(fields), atol=1e-9)
        moved = yaml.safe_load(yaml.safe_dump(fields))
        moved["scene"]["camera"]["position"][2] += 0.1
        world.fields = moved
        wait_until(lambda: np.allclose(published(), truth(moved), atol=1e-9), 30.0, "the new place")
        assert node.poll() is None
    listener.unregister()


def test_without_a_world_it_says_so_and_waits(ros, free_port, wait_until):
    node = ros.run("rig_simulation", "camera_truth_node.py", f"_port:={free_port()}")
    wait_until(lambda: "does not answer" in node.log_path.read_text(), 30.0, "a warning")
    assert node.poll() is None


@pytest.mark.parametrize(("argument", "sentence"), [("_port:=0", "~port is 0"), ("_prt:=5", "~prt")])
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("rig_simulation", "camera_truth_node.py", argument)
    assert node.wait(30.0) == 1
    log = node.log_path.read_text()
    assert sentence in log and "Traceback" not in log
