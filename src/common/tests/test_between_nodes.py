"""What nodes read of each other's messages: transforms as bytes, the teleoperation's state, the robot hand, modes."""

from __future__ import annotations

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.modes import Mode
from common.reasons import Reason, ReasonCode, joined
from common.robot_hand import HAND, hand_state
from common.teleop_record import CLUTCHED, RUNNING, WAITING, teleop_record

pytest.importorskip("rig_msgs.srv")
import rospy
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common.ros.raw_tf import TransformSearch
from reflex_msgs.msg import Hand
from rig_msgs.msg import KukaStatus, TeleopState

pytestmark = pytest.mark.ros

names = st.sampled_from(["a", "b", "base", "tool/desired"])
rows = st.lists(st.tuples(names, names, st.integers(0, 9), st.floats(-2.0, 2.0)), max_size=5)


def any_message(message, cut=None):
    buffer = io.BytesIO()
    message.serialize(buffer)
    return rospy.AnyMsg().deserialize(buffer.getvalue()[:cut])


@settings(max_examples=100, deadline=None)
@given(rows)
def test_a_search_finds_the_first_transform_between_its_frames(rows):
    transforms = [
        TransformStamped(Header(3, rospy.Time(at, 7), parent), child, Transform(Vector3(x, 0, 0), Quaternion(w=1)))
        for parent, child, at, x in rows
    ]
    found = TransformSearch("base", "tool/desired")(any_message(TFMessage(transforms)))
    wanted = [t for t in transforms if (t.header.frame_id, t.child_frame_id) == ("base", "tool/desired")]
    assert (found is None) == (not wanted)
    if found is not None:
        assert (found.message.transform, found.message.header.stamp) == (wanted[0].transform, wanted[0].header.stamp)
        cut = any_message(TFMessage(wanted[:1]), -8)
        assert TransformSearch("base", "tool/desired")(cut) is None, "its numbers are not complete"


def test_the_state_of_the_teleoperation_is_read_with_the_codes_that_are_known():
    message = TeleopState(state="running", reason="x", follows=True, hand_id=7, hand_side="left", hold="taken")
    message.conditions, message.fulfilled, message.limits = ["slow", "in the box"], [False, True], ["yaw"]
    message.reason_codes, message.keep_grip, message.clutched = ["too_fast", "of a later version"], True, True
    record = teleop_record(message)
    assert record.running and record.follows and record.keep_grip and record.clutched
    assert (record.owner, record.hold, record.limits, record.reason) == ((7, True), "taken", ("yaw",), "x")
    assert record.met == {"in the box"} and record.codes == (ReasonCode.TOO_FAST,)
    waiting = teleop_record(TeleopState(state="waiting", hand_id=7))
    assert not waiting.running and waiting.owner is None


def test_several_reasons_keep_their_order():
    reasons = [Reason("the roll is 30 deg", (ReasonCode.NOT_LEVEL,)), Reason("too fast", (ReasonCode.TOO_FAST,))]
    assert joined("hand 3: ", reasons) == Reason(
        "hand 3: the roll is 30 deg; too fast", (ReasonCode.NOT_LEVEL, ReasonCode.TOO_FAST)
    )


def test_the_hand_says_what_each_of_its_parts_does():
    message = Hand()
    for number, motor in enumerate(message.motor):
        motor.joint_angle, motor.load = 0.1 * number, 10.0 * number
    for number, finger in enumerate(message.finger):
        finger.proximal, finger.distal_approx = 1.0 + number, 2.0 + number
        finger.pressure[number], finger.contact[number] = 5.0, True
    state = hand_state(message)
    assert len(state.angles) == len(HAND.motors) == 4 and HAND.bodies(2) == ("proximal_2", "distal_2")
    np.testing.assert_allclose(state.angles, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(state.loads, [0.0, 10.0, 20.0, 30.0])
    np.testing.assert_allclose([state.proximal, state.distal], [[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]])
    assert np.argwhere(state.pressures).tolist() == np.argwhere(state.contacts).tolist() == [[0, 0], [1, 1], [2, 2]]


def test_the_messages_have_the_same_modes_and_states():
    constants = {name: value for name, value in vars(KukaStatus).items() if name.isupper() and isinstance(value, str)}
    assert constants == {mode.name: mode.value for mode in Mode}
    states = TeleopState.CLUTCHED, TeleopState.RUNNING, TeleopState.WAITING
    assert states == (CLUTCHED, RUNNING, WAITING)
