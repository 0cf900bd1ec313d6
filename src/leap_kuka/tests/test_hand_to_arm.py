"""The delay from hand to arm out of the bytes of tf messages, without a master."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common.frames import BASE, FLANGE_MEASURED, TOOL_COMMANDED
from common.poses import inverse, pose
from common.rotations import rotation_from_zyx

pytest.importorskip("rig_msgs.srv")
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.conversions import stamped_transform
from leap_kuka.ros import hand_to_arm

pytestmark = pytest.mark.ros
angles = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
points = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


def message(*transforms, publisher="/controller"):
    """What rospy hands over of a message with (time, pose, parent, child) each."""
    found = [stamped_transform(T, parent, child, rospy.Time.from_sec(at)) for at, T, parent, child in transforms]
    buffer = io.BytesIO()
    TFMessage(found).serialize(buffer)
    return SimpleNamespace(_buff=buffer.getvalue(), _connection_header={"callerid": publisher})


def made(T_tool_flange, others=()):
    """The object, as rospy calls it beside the callbacks of `others`, and how long it rests."""
    rests, impl = [], SimpleNamespace(callbacks=[(other, None) for other in others])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rospy, "Subscriber", lambda *_, **__: SimpleNamespace(impl=impl))
        patch.setattr(hand_to_arm.clock, "sleep", rests.append)
        patch.setattr(hand_to_arm.DelayMonitor, "_looked", {})
        monitor = hand_to_arm.DelayMonitor(T_tool_flange)
        impl.callbacks.append((monitor._take, None))
        yield monitor, rests


@settings(max_examples=50, deadline=None)
@given(angles, points, angles, points)
def test_the_tool_comes_from_the_flange_wherever_it_stands_in_a_message(turn, p, tool_turn, tool_p):
    T_base_flange, T_flange_tool = pose(rotation_from_zyx(*turn), p), pose(rotation_from_zyx(*tool_turn), tool_p)
    others = [(1.0, np.eye(4), BASE, TOOL_COMMANDED), (2.0, np.eye(4), "a", FLANGE_MEASURED)]
    for meter, _ in made(inverse(T_flange_tool)):
        flange = (1.7e9 + 0.25, T_base_flange, BASE, FLANGE_MEASURED)
        meter._take(message(*others))
        meter._take(message(others[0], flange, others[1]))
        (sample,) = meter._meter.tool.samples
        assert sample == pytest.approx((1.7e9 + 0.25, *(T_base_flange @ T_flange_tool)[:3, 3]), abs=1e-9)


def test_values_are_milliseconds_while_both_move_and_empty_otherwise(monkeypatch):
    t = np.arange(0.0, 12.0, 0.01)
    for meter, _ in made(np.eye(4)):
        monkeypatch.setattr(rospy, "get_time", lambda: 1.7e9)
        assert set(meter.values().values()) == {""}
        for time, x in zip(t, 0.1 * np.sin(3.0 * t)):
            meter.palm.add(1.7e9 + time, (x, 0.0, 0.0))
            meter._take(message((1.7e9 + time + 0.06, pose(p=(0.5, 0.0, 2.0 * x)), BASE, FLANGE_MEASURED)))
        monkeypatch.setattr(rospy, "get_time", lambda: 1.7e9 + 12.0)
        assert meter.values() == {"hand_to_arm_ms": "60", "hand_to_arm_p10_ms": "60", "hand_to_arm_p90_ms": "60"}


def test_it_rests_once_for_each_publisher_unless_another_subscriber_would_wait_too():
    for meter, rests in made(np.eye(4)):
        for publisher in ("/controller", "/other", "/controller"):
            meter._take(message(publisher=publisher))
        assert len(rests) == 2
    for meter, rests in made(np.eye(4), others=[print]):
        meter._take(message())
        assert not rests


def test_monitors_of_two_arms_rest_together():
    for first, _ in made(np.eye(4)):
        for second, rests in made(np.eye(4), others=[first._take]):
            for monitor in (first, second):
                monitor._take(message())
            assert len(rests) == 1
