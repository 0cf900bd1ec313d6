"""The node simulation in virtual time: the objects of the simulated world, its pace, and resets."""

from __future__ import annotations

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

from rig_msgs.msg import ObjectStates
from rig_msgs.srv import SetScene
from rig_simulation.control_port import ControlClient, ControlPort
from simulated.hand_wire import HandNetwork

pytestmark = pytest.mark.ros

PORT, SEEN_S = 16434, 0.02
"""Control port of the world; the time from the node's question to the message in the test."""
STATE_PERIOD_S, WINDOW_S = 0.5, 5.0


@pytest.fixture
def world(ros):
    """A running world whose time is stepped; yields a client of its control port."""
    ports = [text for name in ("", "control-", "hand-", "hand-control-") for text in (f"--{name}port", "0")]
    with HandNetwork():
        ros.run("rig_simulation", "world.py", "--stepped", "--scene", "cup", *ports, "--world-port", str(PORT))
        clock.sleep(0.1)
        with ControlClient("127.0.0.1", PORT, 1.0) as client:
            yield client


def test_objects_reset_and_change_of_scene(ros, world):
    states = ros.record("simulation/object_states", ObjectStates)
    ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={PORT}", "_world_rate:=20")
    states.wait(1, 1.0)
    clock.sleep(1.0)
    assert 20 <= len(states) <= 22
    world.ask("step", count=500)
    clock.sleep(0.05 + SEEN_S)
    cup = states[-1].objects[0]
    truth = world.ask("objects")["objects"]["cup"]
    assert (states[-1].header.frame_id, cup.name, cup.touches) == ("kuka/base_frame", "cup", ["table"])
    assert (cup.pose.position.x, cup.pose.position.y, cup.pose.position.z) == pytest.approx(truth["position"])
    assert cup.pose.orientation.z == pytest.approx(truth["quaternion"][2])
    assert cup.clearance == pytest.approx(0.0, abs=5e-4)

    reset = rospy.ServiceProxy("simulation/reset", Trigger)
    assert reset().success
    clock.sleep(0.05 + SEEN_S)
    assert states[-1].objects[0].clearance > 1e-4, "the cup in the air of its start"

    set_scene = rospy.ServiceProxy("simulation/set_scene", SetScene)
    refused = set_scene("kitchen")
    assert not refused.success
    assert "'kitchen'" in refused.message
    assert set_scene("objects").success
    clock.sleep(0.05 + SEEN_S)
    assert len(states[-1].objects) == 5, "the other scene"


class Reports:
    """What stands on /diagnostics about the world."""

    def __init__(self, ros):
        self._arrays = ros.record("/diagnostics", DiagnosticArray)

    def __call__(self):
        return next(s for array in reversed(self._arrays) for s in array.status if s.name == "simulated_world")

    def values(self):
        return {v.key: v.value for v in self().values}


def test_the_pace_of_the_world_is_reported(ros, world):
    reports = Reports(ros)
    ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={PORT}")
    clock.sleep(3.0)
    values = reports.values()
    assert (values["real_time_factor"], values["speed"], values["world_s"]) == ("0.000", "", "0.0")
    world.ask("step", count=500)
    clock.sleep(1.1)
    assert float(reports.values()["world_s"]) == world.ask("state")["time"] > 0.0


def test_a_world_that_is_behind_is_called_slow(ros):
    passed, speed = [0.0, clock.monotonic()], 0.5

    def time():
        now = clock.monotonic()
        passed[:] = [passed[0] + speed * (now - passed[1]), now]
        return passed[0]

    state = {
        "state": lambda: {"time": time(), "speed": 1.0, "contacts": 0},
        "objects": lambda: {"mounting": [0.0, 0.0, 0.0], "frame": "kuka/base_frame", "objects": {}},
    }
    reports = Reports(ros)
    with ControlPort(state) as port:
        ros.run("rig_simulation", "simulation_node.py", "_arm_port:=0", f"_world_port:={port.port}")
        clock.sleep(2 * STATE_PERIOD_S + 0.6)
        report = reports()
        slow = "Too slow: 0.50 s of the world in a second; close other programs."
        assert (report.level, report.message) == (1, slow)
        speed = 1.0
        clock.sleep(0.8 * WINDOW_S)
        assert reports().level == 1
        clock.sleep(0.2 * WINDOW_S + STATE_PERIOD_S + 0.6)
        assert (reports().level, reports().message) == (0, "The world runs in real time.")
    clock.sleep(1.1)
    assert reports().level == 2 and "does not answer" in reports().message
