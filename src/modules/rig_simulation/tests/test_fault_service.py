"""The service that switches faults of all simulated devices, in virtual time."""

from __future__ import annotations

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy

from rig_msgs.srv import SimulationFault
from rig_simulation.control_port import ControlPort
from rig_simulation.faults.injection import Faults
from rig_simulation.faults.leap import LEAP_FAULTS

pytestmark = pytest.mark.ros


LEAP, ARM, TIMEOUT_S = 16438, 30011, 2.0
"""Control ports of the Leap service and of an arm that is not there; how long the node waits for an answer."""


@pytest.fixture
def leap(virtual_graph):
    """The faults of a Leap service with a control port."""
    faults = Faults(LEAP_FAULTS)
    with ControlPort(faults.requests, port=LEAP):
        yield faults


@pytest.fixture
def service(virtual_graph, leap):
    ports = f"_leap_port:={LEAP}", f"_arm_port:={ARM}", "_world_port:=0"
    virtual_graph.run("rig_simulation", "simulation_node.py", *ports)
    rospy.wait_for_service("simulation/fault", 1.0)
    return rospy.ServiceProxy("simulation/fault", SimulationFault)


def test_a_fault_is_switched_on_and_off(service, leap):
    answer = service("leap", "slow", True, 0.5, 0.0)
    assert (answer.success, answer.message) == (True, "on: slow.")
    assert leap.active() == {"slow": 0.5}
    answer = service("leap", "cut", True, 0.0, 60.0)
    assert answer.message == "on: cut, slow."
    for name in ("slow", "cut"):
        answer = service("leap", name, False, 0.0, 0.0)
    assert (answer.success, answer.message) == (True, "no fault is on.")
    assert leap.active() == {}


def test_the_faults_of_a_device_are_listed(service, leap):
    leap.switch("frozen")
    answer = service("leap", "", True, 0.0, 0.0)
    assert answer.success
    assert "(on)" in answer.message
    assert "hand_lost" in answer.message


def test_a_device_that_hangs_is_refused_in_time(virtual_graph, service):
    virtual_graph.wires.serve(("127.0.0.1", ARM))
    begin = clock.monotonic()
    answer = service("arm", "cut", True, 0.0, 0.0)
    assert not answer.success and "timed out" in answer.message
    assert clock.monotonic() - begin == pytest.approx(TIMEOUT_S, abs=0.02)
