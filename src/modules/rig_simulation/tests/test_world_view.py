"""The node that shows the simulated world in RViz."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture
def world_port(processes, wait_until):
    """Control port of a running world with a cup in it."""
    ports = ("--port", "0", "--control-port", "0", "--hand-port", "0", "--hand-control-port", "0", "--world-port", "0")
    process = processes.start("rosrun", "rig_simulation", "world.py", "--scene", "cup", *ports)
    wait_until(lambda: "world: scene" in process.log_path.read_text(), 60.0, "the world")
    return int(process.log_path.read_text().strip().rsplit(":", 1)[1])


def of(array, kind, namespace=""):
    return [marker for marker in array.markers if marker.type == kind and marker.ns.startswith(namespace)]


def test_objects_and_forces_are_shown(ros, world_port, wait_until):
    from visualization_msgs.msg import Marker, MarkerArray

    from rig_simulation.control_port import ControlClient

    objects = ros.record("simulation/objects", MarkerArray)
    contacts = ros.record("simulation/contacts", MarkerArray)
    ros.run("rig_simulation", "world_view.py", f"_port:={world_port}")
    objects.wait(1, 60.0)
    table = of(objects[-1], Marker.CUBE, "table")
    assert len(table) == 1
    cup = of(objects[-1], Marker.CUBE, "object/cup")
    assert len(cup) == 16
    assert {marker.header.frame_id for marker in table + cup} == {"kuka/base_frame"}
    with ControlClient("127.0.0.1", world_port) as world:
        truth = world.ask("objects")["objects"]["cup"]["position"]
        heights = [marker.pose.position.z for marker in cup]
        assert abs(sum(heights) / len(heights) - truth[2]) < 0.005

        def standing():  # the cup falls from just above the table; where it bounces, nothing touches for a moment
            return next((array for array in contacts if of(array, Marker.TEXT_VIEW_FACING)), None)

        array = wait_until(standing, 30.0, "the cup on the table")
        assert of(array, Marker.ARROW)
        (label,) = of(array, Marker.TEXT_VIEW_FACING)
        name, newtons, unit = label.text.split()
        assert (name, unit) == ("table", "N")
        assert 0.3 < float(newtons) < 10.0, "its weight"
        assert label.pose.position.y > truth[1] + 0.1, "beside the cup"
        world.ask("set_scene", scene="empty")
    wait_until(lambda: not of(objects[-1], Marker.CUBE, "object/"), 30.0, "the empty scene")


def test_without_a_world_it_says_so_and_waits(ros, free_port, wait_until):
    from visualization_msgs.msg import MarkerArray

    ros.record("simulation/objects", MarkerArray)
    node = ros.run("rig_simulation", "world_view.py", f"_port:={free_port()}")
    wait_until(lambda: "does not answer" in node.log_path.read_text(), 30.0, "the warning")
    assert node.poll() is None


@pytest.mark.parametrize(("argument", "sentence"), [("_port:=0", "~port is 0"), ("_rte:=5", "~rte")])
def test_bad_parameters_are_one_sentence(ros, argument, sentence):
    node = ros.run("rig_simulation", "world_view.py", argument)
    assert node.wait(30.0) == 1
    log = node.log_path.read_text()
    assert sentence in log
    assert "Traceback" not in log
