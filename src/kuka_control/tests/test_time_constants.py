"""The times that the controller's safety depends on, each in seconds: a doubled constant fails a test here."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from loop_world import DT, World, shifted
from test_controller import GOAL, LATE, Cycles, silent

from common import clock
from common.errors import DeviceError
from common.frames import ONE_ARM
from kst import ConnectionLost, NoServer, ReplyTimeout
from kuka_control.loop.assembly import real_time_loop
from kuka_control.loop.commands import End, Step, Wait
from kuka_control.loop.controller import ReconnectSupervisor
from kuka_control.loop.goal_stream import ServoStream, _cycle
from kuka_control.loop.line_stream import LineStream
from kuka_control.loop.servo_law import ServoLawIdentification
from kuka_control.loop.tracking import PtpSupervision, TrackingMonitor
from kuka_control.model.desired_frame import DesiredFrame, DesiredStream, FrameSources, skew_fault
from kuka_control.model.switches import Switches

TOOL, LEAP, BASE = "kuka/tool_frame/desired", "leap_motion/virtual_frame", "kuka/base_frame"


def first(condition, dt=DT, longest=20.0):
    """Returns the first time at which the condition holds [s]; it is asked at each `dt`."""
    return next(i * dt for i in range(round(longest / dt)) if condition(i * dt))


def new(q):
    """A new reading of joints that are all at q."""
    return np.full(7, q)


@pytest.mark.parametrize(
    ("goal", "reads", "said", "seconds"),
    [
        (0.05, True, "the arm stands still although", 0.3),
        (0.05, False, "no measured joints came for 0.5 s", 0.5),
    ],
)
def test_an_arm_that_does_not_follow_is_found_out(goal, reads, said, seconds):
    monitor, old = TrackingMonitor(), new(0.0)
    assert monitor.step(new(0.0), old, -DT) is None
    assert monitor.step(old, old, 0.0) is None

    def found(now):
        return said in (monitor.step(new(goal), new(0.0) if reads else old, now) or "")

    assert first(found) == pytest.approx(seconds, abs=2.5 * DT)


def test_an_arm_far_behind_is_found_out():
    monitor = TrackingMonitor()
    monitor.step(new(0.0), new(0.0), 0.0)
    found = first(lambda now: monitor.step(new(1.0 + now), new(now), now))
    assert found == pytest.approx(0.1, abs=2.5 * DT)


@pytest.mark.parametrize(
    ("before", "seconds"), [((0.0,), 1.0), ((0.0, 0.5), 0.4), ((0.0, 0.995), 1.0)], ids=["start", "middle", "end"]
)
def test_an_arm_that_something_holds_in_a_motion_is_found_out(before, seconds):
    supervision = PtpSupervision("home", new(1.0))
    for i, q in enumerate(before):
        supervision.step(new(q), (i - len(before) + 1) * DT)
    assert first(lambda now: supervision.step(new(before[-1]), now)) == pytest.approx(seconds, abs=2.5 * DT)


def test_a_motion_that_ends_elsewhere_has_a_moment_to_show_that_it_did_not():
    supervision = PtpSupervision("home", new(1.0))
    found = first(lambda now: supervision.ended_elsewhere(new(0.5), now))
    assert found == pytest.approx(0.3, abs=1.5 * DT)


@pytest.mark.parametrize(("in_servo", "seconds"), [(True, 1.0), (False, 2.0)])
def test_a_silent_robot_is_named_after_120_ms_and_ends_control_after_a_second_in_servo_mode(in_servo, seconds):
    cycles = Cycles(GOAL)
    cycles.controller.in_servo = in_servo
    cycles.run(None)
    assert first(lambda now: silent(cycles, now) and cycles.said) == pytest.approx(0.12, abs=1.5 * DT)

    def ends(now):
        try:
            return not silent(cycles, now)
        except ReplyTimeout:
            return True

    assert first(ends) == pytest.approx(seconds, abs=1.5 * DT)


def test_bad_answers_end_the_link_after_three_seconds():
    cycles = Cycles(GOAL)

    def ends(_):
        try:
            return cycles.run(LATE, dt=0.02)
        except ReplyTimeout:
            return True

    assert first(ends, dt=0.02) == pytest.approx(3.0, abs=0.03)


def test_a_lost_robot_is_tried_again_in_growing_pauses():
    supervisor, error = ReconnectSupervisor(ConnectionLost("gone"), None, None), ConnectionLost("still gone")
    supervisor.lost(error, 0.0)
    tries, said = [supervisor.next_try], []
    for _ in range(10):
        said += [tries[-1]] if supervisor.failed(error, tries[-1]) else []
        tries.append(supervisor.next_try)
    assert np.diff(tries).tolist() == [1.0, 2.0, 4.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0] and tries[0] == 0.5
    assert said == [0.5, 32.5]


def test_a_hand_that_does_not_report_delays_the_start_by_a_second():
    world = World(collision_guard=True)
    world.loop.open_hand(None)
    assert first(lambda _: world.run(DT).mode != "starting") == pytest.approx(1.0, abs=6.0 * DT)


def test_an_exit_waits_two_seconds_for_an_arm_that_something_holds():
    world = World().run(0.1)
    world.arm.held = world.exit_requested = True
    assert first(lambda _: isinstance(world.run(DT).steps[-1].command, End)) == pytest.approx(2.0, abs=2.5 * DT)


def test_a_pick_up_that_the_guard_refuses_is_looked_at_again_each_250_ms(monkeypatch):
    world, times = World().at_home(), []

    def refuse(*_):
        times.append(world.now)
        world.loop._refuse_pick_up("It is tested.", world.now)

    monkeypatch.setattr(world.loop, "_resolve", refuse)
    world.control_on = True
    world.run(2.0, shifted(0.0, 0.0, 0.0))
    np.testing.assert_allclose(np.diff(times), 0.25, atol=3.5 * DT)


def test_a_line_that_something_holds_is_given_up_after_two_seconds():
    stream = object.__new__(LineStream)
    stream._elapsed, stream._progress, stream._limited_by, stream.fraction = 0.0, (0.0, 0.0), None, 0.0
    assert first(stream.blocked) == pytest.approx(2.0, abs=1.5 * DT)


@pytest.mark.parametrize(("stays", "seconds"), [(0.0, 2.12), (0.5, 2.0)], ids=["at home", "away"])
def test_a_test_motion_is_given_up_after_two_seconds_out_or_back(stays, seconds):
    """It is 0.5 deg, and the goal goes back in 0.12 s."""
    identification, measured = ServoLawIdentification(new(0.0)), new(0.0)
    measured[6] = np.radians(stays)
    assert first(lambda now: identification.step(measured, now)[1]) == pytest.approx(seconds, abs=3.5 * DT)


def test_an_arm_that_brakes_by_the_lts_law_is_waited_for_for_300_ms():
    stream, stopped = object.__new__(ServoStream), SimpleNamespace(q=new(0.0))
    stream._limits = SimpleNamespace(at_rest=True, brake=lambda _: stopped)
    stream._lts, stream._time, stream._stands_at, stream._settled = object(), 0.0, None, False
    stream._for_robot = lambda limited, *_: limited
    assert first(lambda now: stream.brake(new(1.0), now) is None) == pytest.approx(0.3, abs=2.5 * DT)


@pytest.mark.parametrize(
    ("dt", "stall", "found"), [(0.099, 0.0, 0.099), (0.101, 0.0, 0.01), (0.599, 0.6, 0.599), (0.601, 0.6, 0.01)]
)
def test_a_gap_of_100_ms_beside_stalls_of_half_a_second_is_crossed_in_a_cycle(dt, stall, found):
    assert _cycle(dt, stall) == found


def test_another_node_takes_a_frame_over_after_a_second():
    for gap, follows in ((0.99, False), (1.01, True)):
        sources = FrameSources()
        sources.heard(TOOL, BASE, "/a", 0.0)
        assert sources.heard(TOOL, BASE, "/b", gap) is follows
    sources = FrameSources()
    sources.heard(TOOL, BASE, "/a", 0.0)
    sources.heard(TOOL, BASE, "/b", 0.0)
    assert sources.conflict(TOOL, 0.99) is not None and sources.conflict(TOOL, 1.01) is None


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_stamp_half_a_second_from_now_is_refused(side):
    assert skew_fault(100.0 + 0.49 * side, 100.0) is None
    assert skew_fault(100.0 + 0.51 * side, 100.0) is not None


def frames(stream, *times, refused=None, in_servo=False):
    """The stream looks at each DT, and new frames come at the times [s]."""
    newest = None
    for i in range(round(max(times) / DT) + 1):
        now = i * DT
        if any(abs(now - at) < DT / 2.0 for at in times):
            newest = DesiredFrame(np.eye(4), 1000.0 + now, refused=refused)
        stream.take(newest, 1000.0 + now, now, in_servo)


def test_a_pause_of_280_ms_begins_a_new_stream():
    for pause, number in ((0.272, 0), (0.288, 1)):
        stream = DesiredStream()
        frames(stream, 0.0, 0.012, 0.024, 0.024 + pause)
        assert stream.number == number


def test_refused_frames_count_for_half_a_second_and_stalls_of_the_loop_for_as_long():
    stream = DesiredStream()
    frames(stream, 0.0, 0.02, refused="It is tested.")
    assert stream.refusal(0.02 + 0.49) and stream.refusal(0.02 + 0.51) is None
    for stall, silence in ((0.49, 0.03), (0.51, 0.03), (0.55, 0.55)):
        stream = DesiredStream()
        frames(stream, 0.0, 0.02)
        stream.take(None, 1000.02 + stall, 0.02 + stall, in_servo=True)
        assert stream.silence == pytest.approx(silence, abs=1e-6), stall


@pytest.mark.ros
class TestNodes:
    """In virtual time."""

    def test_a_robot_hand_that_does_not_report_is_not_known_after_a_second(self, ros):
        import rospy

        from kuka_control.ros.guard_view import HandOpening
        from reflex_msgs.msg import Finger, Hand

        publisher, opening = rospy.Publisher("reflex_takktile/hand_state", Hand, queue_size=1), HandOpening()
        clock.sleep(0.1)

        def show(angle):
            publisher.publish(Hand(finger=[Finger(proximal=angle)] * 3))
            clock.sleep(0.004)
            return clock.monotonic()

        def until(condition, dt=0.002):
            begin = clock.monotonic()
            ros.wait_until(lambda: condition(opening.at(clock.monotonic())), 5.0, "the opening", poll=dt)
            return clock.monotonic() - begin

        show(0.5)
        until(lambda seen: seen is not None)
        show(1.0)
        assert until(lambda seen: seen.proximal[0] == 1.0) == pytest.approx(0.036, abs=0.005)
        assert until(lambda seen: seen is None) == pytest.approx(1.0, abs=0.05)

    def test_a_shutdown_within_half_a_second_explains_a_lost_robot(self, ros):
        from kuka_control.ros.controller_node import ends_soon

        begin = clock.monotonic()
        assert not ends_soon()
        assert clock.monotonic() - begin == pytest.approx(0.51, abs=0.02)

    def test_a_server_that_does_not_run_yet_is_tried_for_20_s_and_a_lost_one_for_2_s_each(self, ros, monkeypatch):
        from kuka_control.ros import controller_node

        tries = []

        def connect(*_, timeout, **__):
            tries.append((clock.monotonic(), timeout))
            raise NoServer("nobody answers")

        monkeypatch.setattr(controller_node.KstClient, "connect", connect)
        config = SimpleNamespace(ip="127.0.0.1", port=1, on_this_machine=True, robot_server="toolbox")
        rig = SimpleNamespace(T_flange_tool=np.eye(4))
        with pytest.raises(DeviceError):
            controller_node.RobotLink(config, rig)
        times, timeouts = np.transpose(tries)
        assert times[-1] - times[0] == pytest.approx(20.0, abs=0.51) and set(timeouts) == {5.0}
        np.testing.assert_allclose(np.diff(times), 0.5, atol=1e-6)
        link = object.__new__(controller_node.RobotLink)
        link._config, link._rig, link.arm = config, rig, None
        with pytest.raises(NoServer):
            link.again()
        assert tries[-1][1] == 2.0

    def test_a_program_gives_up_a_motion_of_which_nothing_is_reported_for_five_seconds(self, ros, monkeypatch):
        from kuka_control.ros import move_program

        class Client:
            def __init__(self, *_):
                self.began = clock.monotonic()

            def wait_for_server(self, _):
                return True

            def send_goal(self, _, feedback_cb):
                self.show = feedback_cb

            def wait_for_result(self, duration):
                clock.sleep(duration.to_sec())
                if clock.monotonic() < self.began + 2.0:
                    self.show(SimpleNamespace(left=0.1, fraction=0.5))

        monkeypatch.setattr(move_program, "ActionClient", Client)
        begin = clock.monotonic()
        with pytest.raises(DeviceError, match="reported nothing for 5 s"):
            move_program.carry_out(SimpleNamespace(straight=True))
        assert clock.monotonic() - begin == pytest.approx(7.0, abs=0.21)

    def test_the_loop_looks_each_25_ms_at_least_whatever_is_published(self, ros, monkeypatch):
        import rospy

        from golden.chain import Run, World
        from kuka_control.ros.controller_node import _Node
        from kuka_control.ros.state_publisher import GoalPublisher

        slow = {"rate_joints": 10.0, "rate_servo": 100.0, "rate_state": 10.0}
        world, times = World(Run("at rest", ((0.0, ""),), settings={"kuka": slow})), []
        monkeypatch.setattr(world.arm, "read", lambda: times.append(clock.monotonic()))

        def main():
            rospy.init_node("kuka_real_time_node")
            link = SimpleNamespace(arm=world.arm, goals=GoalPublisher(), close=lambda: None)
            _Node(world.config, world.rig, link, lambda: real_time_loop(world.config, world.rig), ONE_ARM).spin(None)

        ros.start("kuka_real_time_node", main)
        clock.sleep(6.0)  # with the test motion at home, which the arm does not make
        np.testing.assert_allclose(np.diff(times[-20:]), 0.025, atol=1e-6)

    @pytest.fixture
    def node(self, ros):
        """A controller's node whose robot does not answer, and which can do nothing about it."""
        from kuka_control.ros.controller_node import _Node

        node = object.__new__(_Node)
        node._switches, node._servo_period, node._loop = Switches(), 0.01, SimpleNamespace(counts=Counter())
        node._services = node._moves = SimpleNamespace(hold=lambda _: None, abort=lambda _: None)
        node._show = node._say = node._make_loop = lambda *_: None
        node._controller = SimpleNamespace(
            in_servo=True, cycle=lambda *_: None, restart=lambda *_: None, regained=lambda: False
        )
        return node

    def test_an_arm_that_follows_has_a_second_to_brake_at_the_end(self, node):
        begin = clock.monotonic()
        node._brake()
        assert clock.monotonic() - begin == pytest.approx(1.0, abs=0.015)

    @pytest.mark.parametrize("abilities", [(), ("stop",)])
    def test_a_robot_that_does_not_answer_is_probed_for_twelve_seconds_and_then_connected_anew(self, node, abilities):
        times = [clock.monotonic()]

        def again():
            times.append(clock.monotonic())
            node._switches.request_exit()
            raise NoServer("nobody answers")

        arm = SimpleNamespace(abilities=abilities)
        node._link = SimpleNamespace(arm=arm, close=lambda: times.append(clock.monotonic()), again=again)
        assert not node._stand_by(ReplyTimeout("silent"))
        assert np.diff(times).tolist() == [pytest.approx(12.5, abs=0.1), pytest.approx(0.5, abs=0.06)]
        assert ("end MatlabToolboxServer" in node._loop.reason) == (not abilities), "only the toolbox's may be deaf"

    def test_a_motion_that_the_loop_does_not_start_is_aborted_after_a_second(self, ros, monkeypatch):
        from kuka_control.ros.moves import MoveServer

        server, step = MoveServer(None, None), Step(Wait(), "home", "It is busy.", ())
        aborted, begin = [], clock.monotonic()
        monkeypatch.setattr(server, "abort", aborted.append)
        server.move, server._handle, server._asked = SimpleNamespace(number=1), object(), begin
        while not aborted:
            clock.sleep(DT)
            server.show(step, new(0.0))
        assert clock.monotonic() - begin == pytest.approx(1.0, abs=2.0 * DT)
        assert aborted == ["The controller did not start the motion. It is busy."]
