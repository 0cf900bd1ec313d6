"""The node operator_view: what it shows to those who look, what it hears only then, and its silence without a card."""

import os

import numpy as np
import pytest

pytestmark = pytest.mark.ros

LONG_S = 20.0


@pytest.fixture
def no_card(tmp_path, monkeypatch):
    """A program `aplay` as on a machine without a sound card, which counts its calls in a file."""
    calls, program = tmp_path / "calls", tmp_path / "bin" / "aplay"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\necho call >> {calls}\necho 'no soundcards found' >&2\nexit 1\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    return calls


def skeleton():
    from leap_motion.frames import LeapFinger, LeapFrame, LeapHand

    joints = np.linspace((0.0, 0.2, 0.0), (0.0, 0.2, -0.1), 5)
    chains = [joints + np.array([0.02 * i, 0.0, 0.0]) for i in range(5)]
    turns = np.array([np.eye(3)] * 4)
    fingers = [LeapFinger(i, i, chain, turns, chain[4], 0.1, 0.02, True) for i, chain in enumerate(chains)]
    zero, down, forward = np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, -1.0])
    hand = LeapHand(
        1, "right", joints[0], down, forward, zero, 1.0, 0.0, 0.0, 1.0, 0.08, zero, 0.05, tuple(fingers), None
    )
    return LeapFrame(7, 1000, 110.0, (hand,))


def test_it_shows_what_came_to_those_who_look_and_says_once_that_there_is_no_sound(ros, wait_until, no_card):
    import rospy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from visualization_msgs.msg import MarkerArray

    from leap_motion.msg import Human
    from leap_motion.ros.human import FrameMessage
    from reflex_msgs.msg import Finger, Hand
    from rig_msgs.msg import KukaStatus, OperatorView, TeleopState

    publishers = {
        name: rospy.Publisher(name, kind, queue_size=1)
        for name, kind in (
            ("kuka/status", KukaStatus), ("leap_kuka/state", TeleopState), ("/diagnostics", DiagnosticArray),
            ("/reflex_takktile/hand_state", Hand), ("leap_motion/leap_device", Human),
        )
    }  # fmt: skip
    state = "waiting"

    def publish():
        delay = DiagnosticStatus(
            name="x", values=[KeyValue("hand_to_arm_ms", "unknown"), KeyValue("hand_to_arm_ms", "91")]
        )
        pressed = Finger(contact=[True] + 8 * [False], pressure=[30.0] + 8 * [0.0])
        messages = (
            KukaStatus(mode="servo", reason="follows", limited_by=["joint speed"], round_trip=0.002),
            TeleopState(state=state, reason="why", conditions=["flat"], fulfilled=[True]),
            DiagnosticArray(status=[delay]), Hand(finger=[pressed] * 3), FrameMessage(skeleton(), rospy.Time.now()),
        )  # fmt: skip
        for publisher, message in zip(publishers.values(), messages):
            publisher.publish(message)

    rospy.set_param("operator_view/sounds", True)
    node = ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    views, hands = ros.record("operator_view/rows", OperatorView), ros.record("operator_view/hands", MarkerArray)
    markers = ros.record("operator_view/markers", MarkerArray)

    def texts():
        publish()
        return {row.name: row.text for row in views[-1].rows} if views else {}

    expected = {"Hand": "waiting: why", "Arm": "servo: follows", "Limits": "joint speed", "Delay": "hand to arm 91 ms",
                "Grip": "grips", "Link": "round trip 2.0 ms, jitter 0.0 ms", "Guard": "-"}  # fmt: skip
    wait_until(lambda: expected.items() <= texts().items(), LONG_S, "the rows", poll=0.05)
    for state in ("running", "waiting"):
        wait_until(lambda: texts()["Hand"] == f"{state}: why", LONG_S, "the change", poll=0.05)  # noqa: B023
    bones, joints = wait_until(lambda: texts() and hands and hands[-1].markers, LONG_S, "the hand")
    assert (len(bones.points), len(joints.points)) == (40, 26)
    wait_until(lambda: texts() and markers and len(markers[-1].markers) == 7, LONG_S, "text and bars", poll=0.05)
    assert "Hand: " in markers[-1].markers[0].text
    wait_until(lambda: "no soundcards found" in node.log_path.read_text(), LONG_S, "the word about sounds")
    assert no_card.read_text().count("call") == 1 and node.log_path.read_text().count("No sounds") == 1


def test_a_wrong_parameter_ends_it_with_a_sentence(ros):
    import rospy

    rospy.set_param("operator_view/sounds", "loud")
    node = ros.run("leap_rig", "operator_view_node.py", "__name:=operator_view")
    assert node.wait(LONG_S) == 1
    log = node.log_path.read_text()
    assert "~sounds is 'loud'" in log and "Traceback" not in log
