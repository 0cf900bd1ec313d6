"""What the desired tool's listener says where frames come that no lookup makes new, or others than the awaited one."""

from __future__ import annotations

import pytest

from common import clock
from common.frames import BASE, TOOL_DESIRED
from common.poses import translation

pytest.importorskip("rig_msgs.srv")
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.conversions import stamped_transform
from kuka_control.model.desired_frame import DesiredStream
from kuka_control.ros.desired_tool import DesiredTool

pytestmark = pytest.mark.ros
DT = 0.02
OWN = ("kuka/flange_frame/desired", "kuka/tool_frame/commanded", "kuka/tool_frame/measured", "kuka/link_1")


class Publisher:
    """Publishes transforms on /tf, and takes what a controller gets of them."""

    def __init__(self):
        self._publisher, self.desired = rospy.Publisher("/tf", TFMessage, queue_size=10), DesiredTool()
        self.stream = DesiredStream()
        self.begin = rospy.get_time()
        clock.sleep(0.1)

    def run(self, seconds, *edges):
        """`edges`: parent, child, and a function that returns the stamp at a time [s], or None for no transform.

        Returns how many desired tool frames were accepted, and the sentences about those refused.
        """
        accepted, refused = 0, []
        for _ in range(round(seconds / DT)):
            now = rospy.get_time()
            stamps = [(parent, child, stamp(now)) for parent, child, stamp in edges]
            frames = [
                stamped_transform(translation(0.1, 0.0, 0.2), parent, child, rospy.Time.from_sec(stamp))
                for parent, child, stamp in stamps
                if stamp is not None
            ]
            self._publisher.publish(TFMessage(frames))
            clock.sleep(DT)
            update = self.stream.take(self.desired.wait(0.0), rospy.get_time(), clock.monotonic())
            accepted += update.fresh is not None
            refused += [update.refused] if update.refused else []
        return accepted, refused


def now(t):
    return t


def test_a_stamp_that_stays_is_said_and_not_silence(virtual_graph):
    tool = Publisher()
    begin = tool.begin
    accepted, refused = tool.run(2.0, (BASE, TOOL_DESIRED, lambda t: begin))
    assert accepted == 1 and "with the same stamp or older ones" in refused[0]
    assert "same stamp" in tool.stream.refusal(clock.monotonic())
    assert tool.run(1.0, (BASE, TOOL_DESIRED, now))[0] > 40
    _, refused = tool.run(1.0, (BASE, TOOL_DESIRED, lambda t: t - 0.4 * (t % 0.1)))
    assert refused == [], "a frame that is repeated for less than half a second is not one of these"


def test_stamps_that_go_back_are_said(virtual_graph):
    tool = Publisher()
    tool.run(1.0, (BASE, TOOL_DESIRED, now))
    last = tool.begin + 1.0
    _, refused = tool.run(1.0, (BASE, TOOL_DESIRED, lambda t: last + 0.2 - 0.1 * (t - last)))
    assert any("with the same stamp or older ones" in sentence for sentence in refused)


def test_a_stamp_of_zero_is_said(virtual_graph):
    tool = Publisher()
    accepted, refused = tool.run(2.0, (BASE, TOOL_DESIRED, lambda t: 0.0))
    assert accepted == 0 and refused and all("its stamp is 0" in sentence for sentence in refused)
    assert "its stamp is 0" in tool.stream.refusal(clock.monotonic())


def test_a_frame_below_the_tool_that_is_out_of_step_is_named(virtual_graph):
    tool = Publisher()
    tool.run(1.0, (BASE, "desk", now), ("desk", TOOL_DESIRED, now))
    accepted, refused = tool.run(2.0, (BASE, "desk", lambda t: None), ("desk", TOOL_DESIRED, now))
    assert accepted <= 1 and "it stands in desk, whose newest transform is" in refused[0]
    assert "s older" in tool.stream.refusal(clock.monotonic())
    assert tool.run(1.0, (BASE, "desk", now), ("desk", TOOL_DESIRED, now))[0] > 40


@pytest.mark.parametrize("fault", ["the same stamp", "older"])
def test_a_foreign_stream_that_falters_stays_the_same_stream(virtual_graph, fault):
    """Else what bars it, as that it was far away at first, would end with the first refused frame."""
    tool = Publisher()
    tool.run(1.0, (BASE, "desk", now), ("desk", TOOL_DESIRED, now))
    number, last = tool.stream.number, tool.begin + 1.0
    if fault == "older":
        edges = (BASE, "desk", lambda t: None), ("desk", TOOL_DESIRED, now)
    else:
        edges = (BASE, "desk", now), ("desk", TOOL_DESIRED, lambda t: last)
    _, refused = tool.run(1.0, *edges)
    assert fault in refused[0]
    assert tool.run(0.5, (BASE, "desk", now), ("desk", TOOL_DESIRED, now))[0] > 15
    assert tool.stream.number == number


NAMES = ("tool_frame/desired", "kuka/tool_frame_desired", "/kuka/desired", "iiwa/tool_frame/desired")


@pytest.mark.parametrize("name", NAMES)
def test_a_frame_of_another_name_is_named_with_its_node(virtual_graph, name):
    tool = Publisher()
    assert tool.desired.missing == f"It waits for the frame {TOOL_DESIRED}."
    tool.run(2.0, *[(BASE, child, now) for child in (name, *OWN)])
    said = f"What comes is {name.lstrip('/')}, from {rospy.get_name()}."
    assert tool.desired.missing == f"It waits for the frame {TOOL_DESIRED}. {said}"
    tool.run(2.0, (BASE, TOOL_DESIRED, now))
    assert tool.desired.missing is None


def test_the_rigs_own_frames_are_no_other_name_of_it(virtual_graph):
    tool = Publisher()
    tool.run(2.0, *[(BASE, name, now) for name in OWN])
    assert tool.desired.missing == f"It waits for the frame {TOOL_DESIRED}."
