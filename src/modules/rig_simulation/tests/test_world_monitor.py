"""The node simulation: the objects of the simulated world, its pace, and resets."""

from __future__ import annotations

import re

import pytest

pytestmark = pytest.mark.ros
PORTS = [text for name in ("", "control-", "hand-", "hand-control-", "world-") for text in (f"--{name}port", "0")]


@pytest.fixture
def world(processes, wait_until):
    """A running world whose time is stepped; yields a client of its control port."""
    from rig_simulation.control_port import ControlClient

    program = processes.start("rosrun", "rig_simulation", "world.py", "--stepped", "--scene", "cup", *PORTS)

    def ready():
        return re.search(rb"^world: .*control port 127.0.0.1:(\d+)$", program.log_path.read_bytes(), re.MULTILINE)

    port = int(wait_until(ready, 60.0, "the world")[1])
    with ControlClient("127.0.0.1", port, 10.0) as client:
        client.port = port
        yield client


def test_objects_reset_and_change_of_scene(ros, world, wait_until):
    import rospy
    from std_srvs.srv import Trigger

    from rig_msgs.msg import ObjectStates
    from rig_msgs.srv import SetScene

    states = ros.record("simulation/object_states", ObjectStates)
    ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={world.port}")
    states.wait(3, 30.0)
    world.ask("step", count=500)
    wait_until(lambda: states[-1].objects[0].touches == ["table"], 15.0, "the cup to stand")
    cup = states[-1].objects[0]
    truth = world.ask("objects")["objects"]["cup"]
    assert (states[-1].header.frame_id, cup.name) == ("kuka/base_frame", "cup")
    assert (cup.pose.position.x, cup.pose.position.y, cup.pose.position.z) == pytest.approx(truth["position"])
    assert cup.pose.orientation.z == pytest.approx(truth["quaternion"][2])
    assert cup.clearance == pytest.approx(0.0, abs=5e-4)

    reset = rospy.ServiceProxy("simulation/reset", Trigger)
    reset.wait_for_service(15.0)
    assert reset().success
    wait_until(lambda: states[-1].objects[0].clearance > 1e-4, 15.0, "the cup in the air of its start")

    set_scene = rospy.ServiceProxy("simulation/set_scene", SetScene)
    refused = set_scene("kitchen")
    assert not refused.success
    assert "'kitchen'" in refused.message
    assert set_scene("objects").success
    wait_until(lambda: len(states[-1].objects) == 5, 15.0, "the other scene")


def test_the_pace_of_the_world_is_reported(ros, world, wait_until):
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)

    def values() -> dict:
        found = [s for array in arrays for s in array.status if s.name == "simulated_world" and s.values]
        return {v.key: v.value for v in found[-1].values} if found else {}

    ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={world.port}")
    wait_until(lambda: values().get("real_time_factor"), 30.0, "a factor")
    assert (values()["real_time_factor"], values()["speed"], values()["world_s"]) == ("0.000", "", "0.0")
    world.ask("step", count=500)
    time = world.ask("state")["time"]
    wait_until(lambda: float(values()["world_s"]) == time, 15.0, "the world's time")


def test_a_world_that_is_behind_is_called_slow(ros, wait_until):
    import time

    from diagnostic_msgs.msg import DiagnosticArray

    from rig_simulation.control_port import ControlPort

    began, speed = time.monotonic(), 0.5
    state = {
        "state": lambda: {"time": speed * (time.monotonic() - began), "speed": 1.0, "contacts": 0},
        "objects": lambda: {"mounting": [0.0, 0.0, 0.0], "frame": "kuka/base_frame", "objects": {}},
    }
    arrays = ros.record("/diagnostics", DiagnosticArray)

    def reported() -> tuple:
        found = [s for array in arrays for s in array.status if s.name == "simulated_world"]
        return (found[-1].level, found[-1].message) if found else ()

    with ControlPort(state) as port:
        ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={port.port}")
        slow = "Too slow: 0.50 s of the world in a second; close other programs."
        wait_until(lambda: reported() == (1, slow), 30.0, "the warning")
        speed = 1.0
        wait_until(lambda: reported() == (0, "The world runs in real time."), 60.0, "its end")
    wait_until(lambda: reported() and reported()[0] == 2 and "does not answer" in reported()[1], 30.0, "the end")


def test_without_a_world_it_says_so_and_waits(ros, free_port, wait_until):
    import rospy
    from std_srvs.srv import Trigger

    node = ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={free_port()}")
    wait_until(lambda: "does not answer" in node.log_path.read_text(), 30.0, "a warning")
    reset = rospy.ServiceProxy("simulation/reset", Trigger)
    reset.wait_for_service(15.0)
    answer = reset()
    assert not answer.success
    assert "does not answer" in answer.message
    assert node.poll() is None
