"""Frames that are late or ahead: only a node on another machine can have another clock, and its answers show it."""

from __future__ import annotations

import http.server
import re
import threading
import time
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import numpy as np
import pytest

from common import clock
from common.frames import BASE, HAND_FILTERED, TOOL_DESIRED, VIRTUAL_LEAP
from common.poses import translation
from kuka_control.model.clock_offset import WIDTH_S
from kuka_control.model.desired_frame import DesiredStream

pytest.importorskip("rig_msgs.srv")
import rosgraph.network
import rospy
from tf2_msgs.msg import TFMessage

from common.ros.conversions import stamped_transform
from kuka_control.ros import other_clock
from kuka_control.ros.desired_tool import DesiredTool
from kuka_control.ros.other_clock import NoAnswer, measure

pytestmark = pytest.mark.ros
DT = 0.02


class Stream:
    """Publishes the desired tool frame, by stamps that are `ahead` [s], and takes what a controller gets of it."""

    def __init__(self, parent=BASE):
        self._publisher, self.desired = rospy.Publisher("/tf", TFMessage, queue_size=10), DesiredTool()
        self.stream, self.parent = DesiredStream(), parent
        self.last = None
        clock.sleep(0.1)

    def run(self, seconds, ahead=0.0, tool=True, hand=True):
        """Returns how many frames were accepted, and the sentences about those that were refused."""
        accepted, refused = 0, []
        for _ in range(round(seconds / DT)):
            stamp = rospy.Time.from_sec(rospy.get_time() + ahead)
            frames = [stamped_transform(translation(0.5, 0.0, 0.5), self.parent, TOOL_DESIRED, stamp)] * tool
            if hand:
                frames.append(stamped_transform(translation(0.0, 0.0, 0.2), self.parent, HAND_FILTERED, stamp))
            if self.parent != BASE:
                frames.append(stamped_transform(translation(0.0, 0.0, 0.0), BASE, self.parent, stamp))
            self._publisher.publish(TFMessage(frames))
            clock.sleep(DT)
            self.last = self.desired.wait(0.0)
            update = self.stream.take(self.last, rospy.get_time(), clock.monotonic())
            accepted += update.fresh is not None
            refused += [update.refused] if update.refused else []
        return accepted, refused

    def anew(self):
        """The stream begins anew."""
        for _ in range(100):
            self.stream.take(self.last, rospy.get_time(), clock.monotonic())
            clock.sleep(0.01)


def stated(refused):
    """The figure in a sentence [s]."""
    return float(re.search(r"its stamp is ([0-9.]+) s", refused).group(1))


@pytest.fixture
def elsewhere(virtual_graph, monkeypatch):
    """The test's node runs on another machine; `clock`: what asking its clock brings [s], or raises; `takes`: how long
    that takes [s]."""

    class Elsewhere:
        clock, takes = 0.0, 1.2

    def measure(uri):
        clock.sleep(Elsewhere.takes)
        if isinstance(Elsewhere.clock, Exception):
            raise Elsewhere.clock
        return Elsewhere.clock

    monkeypatch.setattr(rosgraph.network, "is_local_address", lambda host: False)
    monkeypatch.setattr(other_clock, "measure", measure)
    return Elsewhere


@pytest.mark.hazard(10)
@pytest.mark.parametrize("ahead", [-1.0, 1.0, -0.55, 30.0, 3600.0])
def test_frames_of_this_machine_that_are_steadily_late_or_ahead_are_never_followed(virtual_graph, ahead):
    stream = Stream()
    accepted, refused = stream.run(20.0, ahead)
    assert accepted == 0 and stream.desired.offset == 0.0
    assert stated(refused[-1]) == pytest.approx(abs(ahead), abs=0.01)
    assert "runs on this machine, so its frames are late" in refused[-1]


def test_after_the_clock_was_set_nothing_counts_until_the_stream_begins_anew(elsewhere):
    elsewhere.clock = 5.0
    stream = Stream()
    stream.run(2.0, 5.0)
    elsewhere.clock = -3.0
    accepted, refused = stream.run(10.0, -3.0)
    assert accepted == 0 and any("after a pause" in sentence for sentence in refused)
    stream.anew()
    assert stream.run(1.0, -3.0)[0] >= 0.9 / DT


@pytest.mark.parametrize(("why", "words"), [("does not answer", "does not answer"), ("says no time", "says no time")])
def test_a_clock_that_cannot_be_asked_is_refused_with_the_figure_and_what_to_do(elsewhere, why, words):
    elsewhere.clock = NoAnswer(why)
    accepted, refused = Stream().run(5.0, 2.0)
    assert accepted == 0 and words in refused[-1] and "synchronise the clocks" in refused[-1]
    assert stated(refused[-1]) == pytest.approx(2.0, abs=0.01)


def test_a_master_that_does_not_answer_leaves_the_frame_refused(virtual_graph):
    virtual_graph.master_answers = False
    accepted, refused = Stream().run(5.0, -2.0)
    assert accepted == 0 and "the ROS master does not say where" in refused[-1]


@pytest.mark.parametrize(("parent", "foreign"), [(BASE, True), ("world", True), (VIRTUAL_LEAP, False)])
def test_a_frame_that_stands_in_the_virtual_leap_is_a_hands(virtual_graph, parent, foreign):
    stream = Stream(parent)
    assert stream.run(0.5)[0] and stream.last.foreign is foreign
    assert stream.last.engagement == (None if foreign else 0)


def test_a_hand_has_come_in_where_the_virtual_leap_came_without_one(virtual_graph):
    """And not where all was silent, as with an interrupted link."""
    stream = Stream(VIRTUAL_LEAP)
    for pause, engagement in ((False, 0), (False, 0), (True, 1), (False, 1), (True, 2)):
        clock.sleep(1.0)
        if pause:
            stream.run(0.1, tool=False, hand=False)
        stream.run(0.5)
        assert stream.last.engagement == engagement


def test_a_program_that_holds_the_tool_while_no_hand_is_in_view_brings_none_in(virtual_graph):
    stream = Stream(VIRTUAL_LEAP)
    for _ in range(3):
        stream.run(0.5, tool=False, hand=False)
        stream.run(0.5, hand=False)
        assert stream.last.engagement == 0
    stream.run(0.1)
    assert stream.last.engagement == 1, "a hand took the tool over"
    stream.run(0.5, tool=False)
    stream.run(0.1, hand=False)
    assert stream.last.engagement == 1


@pytest.fixture
def asked(elsewhere, monkeypatch):
    """The virtual times at which the clock of another machine was asked [s]."""
    times, measure = [], other_clock.measure
    monkeypatch.setattr(other_clock, "measure", lambda uri: (times.append(clock.monotonic()), measure(uri))[1])
    return times


def test_frames_that_stay_off_let_the_clock_be_asked_every_five_seconds_one_question_at_a_time(elsewhere, asked):
    Stream().run(16.0, -1.0)
    assert np.diff(asked) == pytest.approx([5.0] * 3, abs=2.0 * DT)


def test_a_clock_that_answers_slowly_is_not_asked_a_second_time_meanwhile(elsewhere, asked):
    elsewhere.takes = 20.0
    Stream().run(12.0, -1.0)
    assert len(asked) == 1


def test_a_clock_that_differs_is_asked_again_after_a_minute(elsewhere, asked):
    elsewhere.clock = 1.0
    Stream().run(130.0, 1.0)
    assert np.diff(asked) == pytest.approx([60.0] * 2, abs=2.0 * DT)


def test_while_ros_time_is_simulated_no_clock_is_asked(elsewhere, asked, monkeypatch):
    monkeypatch.setattr(other_clock.rospy.rostime, "is_wallclock", lambda: False)
    accepted, refused = Stream().run(3.0, -1.0)
    assert accepted == 0 and asked == [] and "ROS time is simulated" in refused[-1]


class Shifted(SimpleXMLRPCRequestHandler):
    """A node whose clock is off."""

    shift = 0.0

    def date_time_string(self, timestamp=None):
        return super().date_time_string(time.time() + self.shift)


@pytest.mark.real
@pytest.mark.parametrize("shift", [-7.3, 0.0, 1.6])
def test_the_clock_of_a_rospy_node_is_in_its_answers(shift):
    handler = type("Handler", (Shifted,), {"shift": shift})
    with SimpleXMLRPCServer(("127.0.0.1", 0), handler, logRequests=False) as server:
        server.register_function(lambda caller: (1, "", 1), "getPid")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        assert measure(f"http://127.0.0.1:{server.server_address[1]}/") == pytest.approx(shift, abs=WIDTH_S)
        server.shutdown()


class Silent(http.server.BaseHTTPRequestHandler):
    """A node that says no time."""

    def do_POST(self):
        self.send_response_only(200)
        self.end_headers()

    def log_message(self, *args):
        pass


@pytest.mark.real
def test_a_node_that_says_no_time_and_one_that_is_gone_are_told_apart():
    with http.server.HTTPServer(("127.0.0.1", 0), Silent) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        uri = f"http://127.0.0.1:{server.server_address[1]}/"
        with pytest.raises(NoAnswer, match="says no time"):
            measure(uri)
        server.shutdown()
    with pytest.raises(NoAnswer, match="does not answer"):
        measure(uri)
