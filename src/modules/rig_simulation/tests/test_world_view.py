"""The node simulation shows the simulated world in RViz."""

from __future__ import annotations

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
from visualization_msgs.msg import Marker, MarkerArray

from rig_simulation.control_port import ControlClient
from rig_simulation.devices.reflex import program
from rig_simulation.faults.hand import HAND_FAULTS, HandWire
from rig_simulation.faults.injection import Faults

pytestmark = pytest.mark.ros


class NoLink:
    """The link of a hand that nobody moves."""

    def __init__(self, interface, port):
        self.interface, self.port, self.faults = interface, port, Faults(HAND_FAULTS)
        self.wire = HandWire(self.faults)
        self.send, self.collect, self.close = lambda _: None, list, lambda: None


@pytest.fixture
def world_port(ros, monkeypatch):
    """Control port of a running world with a cup in it."""
    monkeypatch.setattr(program, "HandLink", NoLink)
    ports = ("--port", "0", "--control-port", "0", "--hand-port", "0", "--hand-control-port", "0", "--world-port", "0")
    process = ros.run("rig_simulation", "world.py", "--scene", "cup", *ports)
    ros.wait_until(lambda: "world: scene" in process.log, 60.0, "the world")
    return int(process.log.strip().rsplit(":", 1)[1])


def of(array, kind, namespace=""):
    return [marker for marker in array.markers if marker.type == kind and marker.ns.startswith(namespace)]


def test_objects_and_forces_are_shown(ros, world_port):
    objects = ros.record("simulation/objects", MarkerArray)
    contacts = ros.record("simulation/contacts", MarkerArray)
    ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={world_port}")
    objects.wait(1, 1.0)
    clock.sleep(1.0)
    assert 10 <= len(objects) <= 11
    table = of(objects[-1], Marker.CUBE, "table")
    assert len(table) == 1
    cup = of(objects[-1], Marker.CUBE, "object/cup")
    assert len(cup) == 16
    assert {marker.header.frame_id for marker in table + cup} == {"kuka/base_frame"}
    with ControlClient("127.0.0.1", world_port, 30.0) as world:
        truth = world.ask("objects")["objects"]["cup"]["position"]
        heights = [marker.pose.position.z for marker in cup]
        assert abs(sum(heights) / len(heights) - truth[2]) < 0.005

        def standing():  # the cup falls from just above the table; where it bounces, nothing touches for a moment
            return next((array for array in contacts if of(array, Marker.TEXT_VIEW_FACING)), None)

        array = ros.wait_until(standing, 2.0, "the cup on the table")
        assert of(array, Marker.ARROW)
        (label,) = of(array, Marker.TEXT_VIEW_FACING)
        name, newtons, unit = label.text.split()
        assert (name, unit) == ("table", "N")
        assert 0.3 < float(newtons) < 10.0, "its weight"
        assert label.pose.position.y > truth[1] + 0.1, "beside the cup"
        world.ask("set_scene", scene="empty")
    ros.wait_until(lambda: not of(objects[-1], Marker.CUBE, "object/"), 0.2, "the empty scene")
