"""The tf messages that a controller reads as bytes are those that rospy reads; only what concerns it goes to tf2."""

from __future__ import annotations

import io
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
import tf2_ros
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from common.poses import pose, translation
from common.ros.conversions import pose_from_transform, stamped_transform
from common.ros.raw_tf import RawTfMessage
from common.rotations import rotation_about
from kuka_control.ros.desired_tool import DesiredTool
from kuka_control.ros.other_clock import NodeClock

pytestmark = pytest.mark.ros

names = st.text(st.characters(codec="utf-8", exclude_characters="/"), min_size=1, max_size=12)
numbers = st.lists(st.floats(width=64), min_size=7, max_size=7)
stamps = st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 10**9 - 1))


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(names, names, stamps, numbers, st.booleans()), max_size=6))
def test_the_bytes_are_read_as_rospy_reads_them(rows):
    message, buffer = TFMessage(), io.BytesIO()
    for parent, child, stamp, row, slash in rows:
        transform = Transform(Vector3(*row[:3]), Quaternion(*row[3:]))
        header = Header(7, rospy.Time(*stamp), "/" * slash + parent)
        message.transforms.append(TransformStamped(header, "/" * slash + child, transform))
    message.serialize(buffer)
    raw = list(RawTfMessage().deserialize(buffer.getvalue()).raw_transforms())
    assert [(one.parent, one.child, one.stamp) for one in raw] == [row[:3] for row in rows]
    for one, (_, _, stamp, row, _) in zip(raw, rows):
        np.testing.assert_array_equal(one.numbers, row)
        assert one.message.header.stamp == rospy.Time(*stamp)
        assert math.isnan(row[6]) or one.message.transform.rotation.w == row[6]


class Listener:
    """A DesiredTool without topics, and tf2's own listener with the same messages."""

    def __init__(self, monkeypatch):
        monkeypatch.setattr(NodeClock, "doubt", lambda self, now: None)
        monkeypatch.setattr(rospy, "Subscriber", lambda *args, **kwargs: None)
        monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
        self.desired, self.reference = DesiredTool(), tf2_ros.Buffer(debug=False)

    def hear(self, transforms, static=False):
        message, data = TFMessage(transforms), io.BytesIO()
        message.serialize(data)
        raw = message if static else RawTfMessage().deserialize(data.getvalue())
        raw._connection_header = {"callerid": "/a"}
        (self.desired.static_callback if static else self.desired.callback)(raw)
        for transform in transforms:
            (self.reference.set_transform_static if static else self.reference.set_transform)(transform, "/a")

    def expected(self):
        try:
            found = self.reference.lookup_transform("kuka/base_frame", "kuka/tool_frame/desired", rospy.Time(0))
        except tf2_ros.TransformException:
            return None
        return pose_from_transform(found.transform), found.header.stamp.to_sec()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_desired_tool_is_what_tf2_makes_of_all_frames(seed):
    """Frames change their parents, stand above or below the base, are static or not, and come at different times."""
    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as monkeypatch:
        listener = Listener(monkeypatch)
        frames = ["world", "kuka/base_frame", "a", "b", "c", "kuka/tool_frame/desired"]
        parents = {child: frames[rng.integers(0, i)] for i, child in enumerate(frames) if i}
        last = None
        static = {child for child in parents if rng.random() < 0.2 and child != DESIRED}
        for step in range(30):
            if rng.random() < 0.1:  # a frame that is not static stands in another one from now on
                i = int(rng.integers(1, len(frames)))
                if frames[i] not in static:
                    parents[frames[i]] = frames[rng.integers(0, i)]
            for child in rng.permutation(list(parents)):
                if (child in static and step) or rng.random() < 0.3:
                    continue
                T = pose(rotation_about(int(rng.integers(3)), rng.uniform(-1.0, 1.0)), rng.uniform(-1.0, 1.0, 3))
                stamp = rospy.Time.from_sec(1e9 + 0.01 * step + 1e-3 * rng.integers(5))
                listener.hear([stamped_transform(T, parents[child], str(child), stamp)], static=child in static)
            expected, found = listener.expected(), listener.desired.wait(0.0)
            if expected is None:
                continue
            assert found is not None and found.stamp == expected[1]
            if found is not last:
                np.testing.assert_allclose(found.T_base_tool, expected[0], atol=1e-9)
            last = found


DESIRED, BASE = "kuka/tool_frame/desired", "kuka/base_frame"


@pytest.fixture
def listener(monkeypatch):
    return Listener(monkeypatch)


def hear(listener, parent, x, stamp, child=DESIRED):
    T = translation(x, 0.0, 0.4)
    listener.hear([stamped_transform(T, parent, child, rospy.Time.from_sec(stamp))])
    return listener.desired.wait(0.0)


def test_a_frame_that_stands_nowhere_is_refused_after_a_while_until_it_has_a_way_to_the_base(listener, monkeypatch):
    now = clock.monotonic()
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    assert hear(listener, "table", 0.5, 100.0) is None
    now += 0.3
    assert hear(listener, "table", 0.5, 100.3) is None
    now += 0.3
    refused = hear(listener, "table", 0.5, 100.6)
    assert "stands in table" in refused.conflict
    assert listener.desired.wait(0.0) is refused, "each frame is refused once"
    hear(listener, BASE, 0.1, 100.7, "table")
    assert hear(listener, "table", 0.5, 100.7).conflict is None


def test_simulated_time_that_goes_back_is_a_conflict_once_and_a_wall_clock_that_is_set_back_is_not(listener):
    """Reported in https://github.com/ros/geometry2/issues/347: a clock that goes back by 85 us clears the buffer.
    Tried: wall clock set back.
    """
    try:
        for simulated in (False, True):
            rospy.rostime.switch_to_wallclock() if not simulated else rospy.rostime.set_rostime_initialized(True)
            if simulated:
                rospy.rostime._set_rostime(rospy.Time(200))
            listener.desired._last_time = rospy.Time.now() + rospy.Duration(5.0)
            frame = hear(listener, BASE, 0.5, 300.0 + simulated)
            assert (frame.conflict is None) is not simulated
        assert "went back by 5 s" in frame.conflict
        assert hear(listener, BASE, 0.5, 302.0).conflict is None
    finally:
        rospy.rostime.switch_to_wallclock()


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((math.nan, 0.0, 0.4, 0.0, 0.0, 0.0, 1.0), "kuka/tool_frame/desired is refused: it is not finite"),
        ((0.5, 0.0, 0.4, 0.0, 0.0, math.inf, 1.0), "kuka/tool_frame/desired is refused: it is not finite"),
        ((0.5, 0.0, 0.4, 0.0, 0.0, 0.0, 0.0), "has norm 0 instead of 1"),
        ((0.5, 0.0, 0.4, 0.0, 0.0, 0.0, 1.002), "has norm 1.002 instead of 1"),
    ],
)
def test_bad_numbers_are_refused_with_the_reason_and_the_frame_before_them_does_not_count_again(
    listener, monkeypatch, numbers, said
):
    now = clock.monotonic()
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    good = hear(listener, BASE, 0.5, 100.0)
    bad = Transform(Vector3(*numbers[:3]), Quaternion(*numbers[3:]))
    for i in range(10):
        now += 0.2
        listener.hear([TransformStamped(Header(0, rospy.Time(101, i), BASE), DESIRED, bad)])
        refused = listener.desired.wait(0.0)
        assert said in refused.refused and refused.conflict is None
        assert listener.desired.wait(0.0) is refused, "each frame is refused once, and the one before is not new"
    found = hear(listener, BASE, 0.5, 102.0)
    assert found.refused is None and found.stamp == 102.0 and good.stamp == 100.0


def test_a_frame_of_the_future_is_refused_and_does_not_hide_those_after_it(listener):
    """One that was on its way when the wall clock was set back."""
    now = rospy.get_time()
    assert hear(listener, BASE, 0.5, now).refused is None
    assert re.search(r"its stamp is 2\.\d+ s ahead of", hear(listener, BASE, 0.5, now + 2.5).refused)
    assert hear(listener, BASE, 0.5, now + 0.02).stamp == pytest.approx(now + 0.02)


def clock_of_another_machine(listener, monkeypatch, ahead, rate=50.0):
    """Returns what hears the next frame of a node, at the rate [Hz]; its clock is `ahead` [s], and is asked at once."""
    says = [ahead]
    monkeypatch.setattr(NodeClock, "doubt", lambda self, now: setattr(self, "_result", says[0]))
    at = [clock.monotonic(), rospy.get_time()]
    monkeypatch.setattr(clock, "monotonic", lambda: at[0])
    monkeypatch.setattr(rospy, "get_time", lambda: at[1])

    def next_frame(x=0.5, ahead=ahead):
        at[:] = at[0] + 1.0 / rate, at[1] + 1.0 / rate
        says[0] = ahead
        hear(listener, BASE, 0.1, at[1] + ahead, "table")
        return hear(listener, "table", x, at[1] + ahead), at[1]

    return next_frame


@pytest.mark.parametrize("ahead", [-30.0, -2.0, 2.0, 30.0])
def test_a_clock_that_differs_is_measured_and_its_stamps_are_of_this_machine_then(listener, monkeypatch, ahead):
    next_frame = clock_of_another_machine(listener, monkeypatch, ahead)
    first = next_frame()[0]
    assert f"{abs(ahead):.3f} s" in first.refused and "being asked" in first.refused
    next_frame()  # the table that came before it is by the other clock
    for i, (frame, at) in enumerate([next_frame(0.5 + 0.001 * i) for i in range(20)]):
        assert frame.refused is None and frame.conflict is None and frame.clock == 1
        assert frame.stamp == pytest.approx(at, abs=1e-3)
        assert frame.T_base_tool[0, 3] == pytest.approx(0.6 + 0.001 * i)
    assert listener.desired.stamp.to_sec() == pytest.approx(at + ahead, abs=1e-6), "as it came"
    assert next_frame(ahead=0.0)[0].refused, "a clock that is set is a jump at first"
    next_frame(ahead=0.0)
    frame, at = next_frame(ahead=0.0)
    assert frame.refused is None and frame.clock == 2 and frame.stamp == pytest.approx(at)


def test_a_static_desired_tool_is_refused_with_a_sentence(listener):
    transform = stamped_transform(translation(0.5, 0.0, 0.4), BASE, DESIRED, rospy.Time.now())
    listener.hear([transform], static=True)
    frame = listener.desired.wait(0.0)
    assert "static transform" in frame.refused and frame.conflict is None
    assert hear(listener, BASE, 0.5, rospy.get_time()).refused is None, "one with stamps counts"


def test_desired_tools_are_refused_while_simulated_time_stands_still(listener, monkeypatch):
    now = clock.monotonic()
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    try:
        rospy.rostime._set_rostime(rospy.Time(200))
        assert hear(listener, BASE, 0.5, 200.0).refused is None
        now += 0.6
        first = hear(listener, BASE, 0.5, 200.0)
        now += 0.1
        second = hear(listener, BASE, 0.5, 200.0)
        assert "ROS time has stood still for 0.6 s" in first.refused and "0.7 s" in second.refused
        assert first.stamp != second.stamp, "each counts"
        rospy.rostime._set_rostime(rospy.Time(201))
        assert hear(listener, BASE, 0.5, 201.0).refused is None
    finally:
        rospy.rostime.switch_to_wallclock()


def test_bytes_that_are_no_tf_message_are_left_out_and_the_next_message_counts(listener, caplog):
    for data in (b"\x01", b"\xff\xff\xff\xff", b"\x01\0\0\0" + bytes(12) + b"\x02\0\0\0\xff\xfe"):
        damaged = RawTfMessage().deserialize(data)
        damaged._connection_header = {"callerid": "/hostile"}
        listener.desired.callback(damaged)
    assert hear(listener, BASE, 0.5, 100.0).conflict is None


def test_frames_in_a_circle_have_no_way_to_the_base(listener, monkeypatch):
    now = clock.monotonic()
    monkeypatch.setattr(clock, "monotonic", lambda: now)
    for i in range(2):
        for parent, child in (("a", "b"), ("b", "a")):
            hear(listener, parent, 0.1, 100.0 + i, child)
        refused = hear(listener, "a", 0.5, 100.0 + i)
        now += 0.6
    assert "stands in a" in refused.conflict
