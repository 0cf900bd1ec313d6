"""Messages and services of the KUKA nodes keep their MD5 sums, so that other people's nodes can talk to them."""

import pytest

pytestmark = pytest.mark.ros

JOINTS = "9e2eae0c12cea832bdfe7ea69bc8eae1"
EXIT = "937c9679a518e3a18d831e57125ea522"
SWITCH = "09fb03525b03e7ea1fd3992bafd87e16"
MESSAGES = {"jointPositions": JOINTS, "jointTorquesExternal": JOINTS, "jointTorquesMeasured": JOINTS}
SERVICES = {
    "exitApp": EXIT,
    "exitAppEmergency": EXIT,
    "setKukaControl": SWITCH,
    "setGripperControl": SWITCH,
    "setPayload": "96fbe2a49585a736ad8b4a31afbaf099",
    "setScalingFactor": "96fbe2a49585a736ad8b4a31afbaf099",
}


@pytest.mark.parametrize("name", MESSAGES)
def test_message(name):
    message = getattr(pytest.importorskip("kuka_msgs.msg"), name)
    assert (message._type, message._md5sum) == (f"kuka_msgs/{name}", MESSAGES[name])


@pytest.mark.parametrize("name", SERVICES)
def test_service(name):
    service = getattr(pytest.importorskip("kuka_msgs.srv"), name)
    assert (service._type, service._md5sum) == (f"kuka_msgs/{name}", SERVICES[name])
