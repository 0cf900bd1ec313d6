"""The measured tool out of the bytes of tf messages, without a master."""

from __future__ import annotations

import io
from types import SimpleNamespace

import numpy as np
import pytest

from common.frames import BASE, FLANGE_MEASURED
from common.poses import pose, translation

pytest.importorskip("rig_msgs.srv")
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.conversions import stamped_transform
from leap_kuka.ros.measured_tool import MeasuredTool

pytestmark = pytest.mark.ros
FLANGE_TOOL = translation(0.0, 0.0, 0.1)
EARLIER, LATER = pose(p=(0.4, 0.0, 0.5)), pose(p=(0.5, 0.1, 0.4))


@pytest.fixture
def received(monkeypatch):
    """Returns what a message of the controller tells: (pose, parent, child) each, and its bytes up to `end`."""

    def receive(*transforms, end=None):
        now = rospy.Time.from_sec(1.7e9)
        monkeypatch.setattr(rospy, "Subscriber", lambda *_, **__: None)
        monkeypatch.setattr(rospy.Time, "now", lambda: now)
        measured, buffer, header = MeasuredTool(FLANGE_TOOL), io.BytesIO(), {"callerid": "/controller"}
        TFMessage([stamped_transform(T, parent, child, now) for T, parent, child in transforms]).serialize(buffer)
        measured._on_status(SimpleNamespace(_connection_header=header))
        measured._on_tf(SimpleNamespace(_buff=buffer.getvalue()[:end], _connection_header=header))
        return measured()

    return receive


@pytest.mark.parametrize("slash", ["", "/"])
def test_the_last_flange_of_a_message_counts_with_or_without_the_slash_of_old_nodes(received, slash):
    base, flange = slash + BASE, slash + FLANGE_MEASURED
    T_base_tool = received((EARLIER, base, flange), (LATER, base, flange), (EARLIER, base, "another"))
    np.testing.assert_allclose(T_base_tool, LATER @ FLANGE_TOOL, atol=1e-12)


@pytest.mark.parametrize(
    ("transform", "end", "fault"),
    [
        ((LATER, "world", FLANGE_MEASURED), None, "is not in"),
        ((LATER, BASE, FLANGE_MEASURED + "_2"), None, "is not in"),
        ((LATER, BASE, FLANGE_MEASURED), -8, "damaged"),
        ((pose(p=(np.nan, 0.0, 0.0)), BASE, FLANGE_MEASURED), None, "not finite"),
        ((LATER, BASE, "another"), None, "publishes no"),
    ],
)
def test_what_is_no_flange_in_the_base_is_refused(received, transform, end, fault):
    with pytest.raises(ValueError, match=fault):
        received(transform, end=end)
