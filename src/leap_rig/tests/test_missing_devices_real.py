"""The rig and the camera as they are typed, where no device answers: each is named, and nothing simulates it."""

import pytest

pytest.importorskip("rig_msgs.srv")
import rospy

pytestmark = [pytest.mark.ros, pytest.mark.real]
SENTENCES = {"No Leap service answers", "The network interface 'none0'"}


def test_what_does_not_answer_is_named_with_the_way_without_hardware_and_nothing_is_simulated(
    ros, free_port, wait_until
):
    quiet = {"gui": "false", "operator_view": "false"}
    addresses = {"leap_port": free_port(), "robot_ip": "127.0.0.1", "hand_interface": "none0"}
    logs = {
        ros.launch("leap_rig", "leap_rig.launch", **quiet, **addresses).log_path: SENTENCES,
        ros.launch("vision", "camera_apriltag.launch").log_path: {"openni"},  # absent: the device, or its library
    }
    for log, sentences in logs.items():
        for words in sentences:
            wait_until(lambda log=log, words=words: named(log.read_text(), words), 60.0, words)
    nodes = {node for each in rospy.get_master().getSystemState()[2] for _, names in each for node in names}
    assert "/leap_driver" in nodes and not nodes & {"/leapd", "/simulated_world", "/simulation", "/operator"}
    assert not any("is simulated" in log.read_text() for log in logs)


def named(text, words):
    """Returns whether a line has the words, whatever their case, and says what to do without hardware."""
    return any(words.lower() in line.lower() and "sim:=true" in line for line in text.splitlines())
