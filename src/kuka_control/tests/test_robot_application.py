"""A controller on the simulated robot with the robot application; all in virtual time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from link_world import bench
from loop_world import rig

from common import clock
from common.errors import ConfigError
from kst import ApplicationSettings
from kuka_control.loop.moves import MoveGoal, MovePlanner, MoveState
from kuka_control.model.config import RealTimeConfig
from kuka_control.model.switches import Switches

KNOWN = ApplicationSettings(tool_mass=1.12, tool_centre=(-0.022, 0.0, 0.0727))
CANCELLED = "The program cancelled the motion."


def events(one, seconds):
    """Runs so long; returns the last step, and what was logged."""
    said, end = [], clock.monotonic() + seconds
    while clock.monotonic() < end:
        step = one.cycle()
        said += [event.sentence for event in step.events]
        one.mode = step.mode
        clock.sleep(0.004)
    return step, said


def homing(one):
    """The arm is on its way home, and moves."""
    one.run(clock.monotonic() + 5.0, "homing")
    events(one, 0.8)
    assert one.controller.moving
    return one


def following(one):
    one.run(clock.monotonic() + 30.0, "servo")
    events(one, 1.0)
    assert one.controller.in_servo
    return one


def at_rest(one):
    before = one.robot.q.copy()
    clock.sleep(0.5)
    return bool(np.max(np.abs(one.robot.q - before)) < 1e-6)


def test_it_follows_with_the_whole_state_in_each_answer():
    with bench(application=KNOWN) as one:
        following(one)
        before = len(one.sent)
        step, _ = events(one, 1.0)
        assert step.mode == "servo" and set(one.sent[before:]) == {"jpState"}
        state = one.arm.state
        assert one.arm.estimated_in_servo == () and state.moment is not None and state.force is not None
        assert one.arm.reckoned == (True, 0.0)


def test_the_toolbox_hears_no_other_word_than_before():
    with bench() as one:
        following(one)
        assert not [word for word in one.sent if word.startswith("lr") or word == "jpState"]
        assert one.arm.abilities == frozenset()


def test_control_off_stops_a_motion_and_nothing_moves_until_it_is_asked_for():
    with bench(application=KNOWN) as one:
        homing(one).switch(False)
        step, said = events(one, 1.0)
        assert step.mode == "stopped" and "stopped the motion to home: control is off." in step.reason
        assert "The robot says: the motion was stopped by the client." in said
        assert at_rest(one)
        events(one, 2.0)
        assert at_rest(one)
        one.switch(True)
        one.run(clock.monotonic() + 20.0, "home")


@pytest.mark.parametrize("seconds", [0.0, 3.0])
def test_a_motion_is_paused_and_continues(seconds):
    with bench(application=KNOWN) as one:
        homing(one).paused = True
        step, _ = events(one, 0.5 if seconds else 0.02)
        assert step.mode == "homing" and "The motion to home is paused" in step.reason
        if seconds:
            assert events(one, seconds)[0].mode == "homing" and one.controller.moving
            before = one.robot.q
            events(one, 0.5)
            np.testing.assert_array_equal(one.robot.q, before)
        one.paused = False
        one.run(clock.monotonic() + 20.0, "home")


def test_a_paused_motion_is_ended_by_control_off():
    with bench(application=KNOWN) as one:
        homing(one).paused = True
        events(one, 0.5)
        one.switch(False)
        step, _ = events(one, 0.5)
        assert step.mode == "stopped" and "stopped the motion to home" in step.reason


def test_control_off_stops_no_motion_of_the_toolbox():
    with bench() as one:
        homing(one).switch(False)
        step, _ = events(one, 1.0)
        assert step.mode == "homing" and one.controller.moving


def test_a_motion_home_because_control_is_off_goes_on():
    with bench(application=KNOWN) as one:
        following(one).switch(False)
        one.run(clock.monotonic() + 20.0, "home")


def test_while_the_control_loop_hangs_the_robot_stops_the_motion():
    with bench(application=KNOWN) as one:
        homing(one)
        clock.sleep(1.0)
        assert at_rest(one)
        step, _ = events(one, 0.2)
        assert step.mode == "stopped" and "silent for longer than watchdog_brake" in step.reason


def test_a_slow_control_loop_is_alive():
    with bench(application=KNOWN) as one:
        homing(one)
        for _ in range(10):
            clock.sleep(0.15)
            assert one.cycle().mode == "homing"


def test_while_the_control_loop_hangs_the_robot_brakes_and_holds():
    with bench(application=KNOWN) as one:
        following(one)
        clock.sleep(1.0)
        assert at_rest(one)
        step, _ = events(one, 0.5)
        assert step.mode == "stopped" and "silent for longer than watchdog_brake" in step.reason
        assert not one.controller.in_servo
        one.switch(False)
        events(one, 0.1)
        one.switch(True)
        one.run(clock.monotonic() + 20.0, "servo")


def test_a_stop_from_another_thread_ends_following():
    with bench(application=KNOWN) as one:
        following(one)
        one.arm.stop()
        step, _ = events(one, 0.5)
        assert step.mode == "stopped" and "The robot stopped the arm: it was asked to." in step.reason
        assert at_rest(one)


@pytest.mark.ros
@pytest.mark.parametrize("application", [KNOWN, None])
def test_emergency_stop_stops_the_arm_while_the_control_loop_hangs(application):
    """Of the toolbox the arm completes its motion."""
    from kuka_control.ros.controller_node import RobotLink

    with bench(application=application) as one:
        link = object.__new__(RobotLink)
        link.arm = homing(one).arm
        assert link.stop() == ("the robot was told to stop" if application else None)
        clock.sleep(0.15)
        assert at_rest(one) is (application is not None)


@pytest.mark.ros
def test_a_stop_that_does_not_reach_the_robot_is_said():
    from kuka_control.ros.controller_node import RobotLink

    with bench(application=KNOWN) as one:
        link = object.__new__(RobotLink)
        link.arm = one.arm
        channel = one.client._channel
        channel._transport.abort()
        channel._address = "127.0.0.1", 1
        assert "could not be told to stop" in link.stop()


def test_the_payload_goes_to_the_robot_at_rest():
    with bench(application=KNOWN) as one:
        homing(one).payload = 0.5
        events(one, 0.1)
        assert "lrLoad" not in one.sent and one.arm.reckoned == (True, 0.0)
        one.run(clock.monotonic() + 20.0, "home")
        assert one.arm.reckoned == (True, 0.5) and one.sent.count("lrLoad") == 1


def test_a_payload_that_the_robot_refuses_is_said_once():
    with bench(application=KNOWN) as one:
        one.payload = 20.0
        _, said = events(one, 1.0)
        assert sum("does not take the payload of 20 kg" in sentence for sentence in said) == 1
        assert one.arm.reckoned == (True, 0.0)


def test_without_a_mass_no_load_is_told():
    with bench(application=ApplicationSettings()) as one:
        one.payload = 0.5
        events(one, 0.5)
        assert "lrLoad" not in one.sent and one.arm.reckoned == (False, 0.0)


def test_switches_say_what_control_off_does():
    switches = Switches()
    switches.report("homing", None, stops=True)
    assert "the robot stops the arm" in switches.set_control(False).message
    assert switches.now.stop_count == 1
    switches.report("home", None)
    assert switches.set_control(False).message == "Control is off already."


def test_only_a_motion_that_the_robot_can_pause_is_paused():
    switches = Switches()
    switches.report("home", None)
    assert not switches.set_paused(True).success and not switches.now.paused
    switches.report("homing", None, stops=True)
    assert switches.set_paused(True).success and switches.now.paused
    switches.report("home", None)
    assert not switches.now.paused


def test_the_watchdogs_times_fit():
    with pytest.raises(ConfigError, match="watchdog_end is 0.2 s, but must be above watchdog_brake, 0.3 s"):
        rig(RealTimeConfig, watchdog_brake=0.3, watchdog_end=0.2)


def test_what_the_robot_knows_is_taken_off_no_second_time():
    load = rig(RealTimeConfig)[1].load
    assert not load.unknown(True).torques(np.full(7, 0.5)).any() and load.unknown(False) is load


@pytest.mark.ros
def test_a_stop_that_hangs_does_not_delay_the_end_of_the_controller(virtual_graph, monkeypatch):
    from kuka_control.ros import services

    ended, began = [], clock.monotonic()
    monkeypatch.setattr(services.os, "_exit", lambda code: ended.append((clock.monotonic() - began, code)))
    one = services.Services(Switches(), lambda: clock.sleep(1.0))
    assert one._end_at_once(None)[0]
    ((seconds, code),) = ended
    assert seconds == pytest.approx(services.ANSWER_S, abs=0.01) and code == 2


def test_a_released_enabling_device_stops_a_motion_and_control_stays_on():
    with bench(application=KNOWN) as one:
        homing(one).stop_count += 1
        one.stop_because = "the enabling device was released"
        step, _ = events(one, 1.0)
        assert step.mode == "stopped" and "stopped the motion to home: the enabling device was released." in step.reason
        assert at_rest(one)


@pytest.mark.parametrize("application", [KNOWN, None])
def test_a_cancelled_motion_of_a_program_stops_where_the_robot_can_stop_it(application):
    with bench(application=application) as one:
        one.hand = False
        one.run(clock.monotonic() + 20.0, "home")
        planner = MovePlanner(one.rig, {}, 0.15, 0.25, None)
        motion = planner.plan(1, MoveGoal(one.rig.home.q + np.eye(7)[0]), one.arm.measured_joints)
        one.move = motion
        step, _ = events(one, 1.0)
        assert step.mode == "moving" and one.controller.moving, step.reason
        one.move = replace(motion, cancelled=True)
        step, _ = events(one, 0.5)
        if application is None:
            assert step.mode == "moving" and one.controller.moving
            return
        assert step.mode == "holding" and step.move.state is MoveState.CANCELLED and step.move.sentence == CANCELLED
        assert at_rest(one)
        one.move = planner.plan(2, MoveGoal(one.rig.home.q), one.arm.measured_joints)
        one.run(clock.monotonic() + 20.0, "moving")


def test_control_off_after_a_cancel_leaves_the_arm_where_it_is():
    with bench(application=KNOWN) as one:
        one.hand = False
        one.run(clock.monotonic() + 20.0, "home")
        motion = MovePlanner(one.rig, {}, 0.15, 0.25, None).plan(
            1, MoveGoal(one.rig.home.q + np.eye(7)[0]), one.arm.measured_joints
        )
        one.move = motion
        events(one, 1.0)
        one.move = replace(motion, cancelled=True)
        one.cycle()
        one.switch(False)
        step, _ = events(one, 1.0)
        assert step.mode == "stopped" and "control is off" in step.reason and at_rest(one)


@pytest.mark.ros
def test_what_counts_as_released(virtual_graph):
    import rospy

    from kuka_control.numbers import ENABLING_SILENT_S
    from kuka_control.ros.enabling import EnablingWatch
    from rig_msgs.msg import TeleopState

    released = []
    watch = EnablingWatch(released.append)
    publisher = rospy.Publisher("leap_kuka/state", TeleopState, queue_size=10)

    def say(enabled, needed=True):
        publisher.publish(TeleopState(enabling_needed=needed, enabled=enabled))
        clock.sleep(0.1)
        watch.check()

    say(False)
    say(True, needed=False)  # what need not be pressed is never released
    say(False, needed=False)
    assert released == []
    say(True)
    say(False)
    assert released == ["the enabling device was released"]
    say(True)
    for _ in range(10):
        say(True)
    clock.sleep(ENABLING_SILENT_S + 0.1)
    watch.check()
    watch.check()
    assert len(released) == 2 and "is silent for 0.5 s" in released[1]
