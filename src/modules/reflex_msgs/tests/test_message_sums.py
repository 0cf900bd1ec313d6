"""Messages and services are those of the published driver: their MD5 sums decide whether two ROS nodes can talk."""

import pytest

pytestmark = pytest.mark.ros

MESSAGES = {
    "Hand": "5328a4ca4ff4a136db2555c3178a3e1b",
    "Finger": "b5232f74e901b48063f64cfc32aefbe0",
    "Motor": "66d6779b4fae4b7b68e0863263c3993c",
    "FingerPressure": "fe4417140692b62d71a7ba82897b83f5",
    "Command": "bcad31578e17a6697c2483ccda6d52eb",
    "PoseCommand": "ec8e01f7c46594906539a78e3918a7c2",
    "VelocityCommand": "ec8e01f7c46594906539a78e3918a7c2",
    "ForceCommand": "ec8e01f7c46594906539a78e3918a7c2",
    "RadianServoCommands": "ba1e88d9da1745cdc1900895d8c434b9",
    "RawServoCommands": "aea318ab5663e05395d3ab895fd67e1e",
}
SERVICES = {
    "SetSpeed": "7e4d6fd69113a7a3ab5caa755082c6b7",
    "SetTactileThreshold": "01cec83f9d223083364c730460331524",
}


@pytest.mark.parametrize("name", MESSAGES)
def test_message(name):
    message = getattr(pytest.importorskip("reflex_msgs.msg"), name)
    assert (message._type, message._md5sum) == (f"reflex_msgs/{name}", MESSAGES[name])


@pytest.mark.parametrize("name", SERVICES)
def test_service(name):
    service = getattr(pytest.importorskip("reflex_msgs.srv"), name)
    assert (service._type, service._md5sum) == (f"reflex_msgs/{name}", SERVICES[name])
