"""The service that switches faults of all simulated devices."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.ros


@pytest.fixture
def leap():
    """A control port with the faults of the Leap service."""
    from rig_simulation.control_port import ControlPort
    from rig_simulation.faults.injection import Faults
    from rig_simulation.faults.leap import LEAP_FAULTS

    faults = Faults(LEAP_FAULTS)
    with ControlPort(faults.requests) as port:
        port.faults = faults
        yield port


@pytest.fixture
def service(ros, leap, free_port):
    import rospy

    from rig_msgs.srv import SimulationFault

    ports = f"_leap_port:={leap.port}", f"_arm_port:={free_port()}", "_world_port:=0"
    ros.run("rig_simulation", "simulation_node.py", *ports)
    rospy.wait_for_service("simulation/fault", 30.0)
    return rospy.ServiceProxy("simulation/fault", SimulationFault)


def test_a_fault_is_switched_on_and_off(service, leap):
    answer = service("leap", "slow", True, 0.5, 0.0)
    assert (answer.success, answer.message) == (True, "on: slow.")
    assert leap.faults.active() == {"slow": 0.5}
    answer = service("leap", "cut", True, 0.0, 60.0)
    assert answer.message == "on: cut, slow."
    for name in ("slow", "cut"):
        answer = service("leap", name, False, 0.0, 0.0)
    assert (answer.success, answer.message) == (True, "no fault is on.")
    assert leap.faults.active() == {}


def test_the_faults_of_a_device_are_listed(service, leap):
    leap.faults.switch("frozen")
    answer = service("leap", "", True, 0.0, 0.0)
    assert answer.success
    assert "(on)" in answer.message
    assert "hand_lost" in answer.message


@pytest.mark.parametrize(
    ("request_fields", "sentence"),
    [
        (("foot", "cut", True, 0.0, 0.0), "arm, leap, hand, camera"),
        (("leap", "dance", True, 0.0, 0.0), "bursts, cut"),
        (("leap", "slow", True, 100.0, 0.0), "0.001 to 60"),
        (("leap", "cut", True, float("nan"), 0.0), "nan"),
        (("leap", "cut", True, 0.0, -1.0), "-1.0"),
        (("arm", "cut", True, 0.0, 0.0), "answer"),
    ],
)
def test_nonsense_and_absent_devices_are_refused_in_a_sentence(service, leap, request_fields, sentence):
    answer = service(*request_fields)
    assert not answer.success
    assert sentence in answer.message
    assert leap.faults.active() == {}
