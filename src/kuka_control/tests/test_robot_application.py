"""A controller on the simulated robot with the robot application; all in virtual time."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from link_world import SOFT, bench
from loop_world import rig

from common import clock
from common.errors import ConfigError
from common.modes import Mode
from kst import ApplicationSettings, ConnectionLost, WrongMode
from kuka_control.loop.moves import MoveGoal, MovePlanner, MoveState, ProgramMotion
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


@pytest.mark.parametrize(("application", "program"), [(KNOWN, "LeapRigServer"), (None, "MatlabToolboxServer")])
def test_a_lost_robot_is_to_be_started_by_its_own_name(application, program):
    with bench(application=application) as one:
        one.run(clock.monotonic() + 5.0, "homing")
        one.server.stop()
        with pytest.raises(ConnectionLost, match=f"restart {program} on the smartPad"):
            one.run(clock.monotonic() + 30.0)


def test_nobody_is_warned_of_what_was_asked_for():
    with bench(application=KNOWN) as one:
        step, said = events(one, 15.0)
        assert step.mode == "servo" and said and not [each for each in said if "The robot says" in each]


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


@pytest.mark.ros
def test_a_wait_for_hand_guiding_delays_no_other_switch(virtual_graph, monkeypatch):
    from kuka_control.model.switches import SwitchReply
    from kuka_control.ros import services

    switches, answers = Switches(), []

    def guide(on):
        clock.sleep(2.0)
        return SwitchReply(on, "It begins.")

    offered = {}
    monkeypatch.setattr(services.rospy, "Service", lambda name, _, answer: offered.update({name: answer}))
    one = services.Services(switches, guide=guide)
    clock.Thread(target=lambda: answers.append(offered["kuka/guide"](SimpleNamespace(data=True))), daemon=True).start()
    clock.sleep(0.1)
    began = clock.monotonic()
    assert offered["kuka/kuka_control"](SimpleNamespace(data=True))[0]
    one.stop_motion("the enabling device was released")
    assert clock.monotonic() - began < 0.1 and not answers
    clock.sleep(2.0)
    assert answers == [(True, "It begins.")]


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


@pytest.mark.ros
@pytest.mark.parametrize(("stops", "left"), [(True, "the robot stops, as its client"), (False, "runs to its end")])
def test_what_is_said_of_a_controller_that_hangs_is_true_of_its_robot(monkeypatch, stops, left):
    from common.ros.service_calls import ServiceFailed
    from kuka_control.ros import emergency

    def hangs(timeout):
        raise ServiceFailed(emergency.SERVICE, "does not answer", False)

    killed = []
    monkeypatch.setattr(emergency, "kill", killed.append)
    monkeypatch.setattr(emergency, "runs", lambda process: process not in killed)
    process = emergency.ControllerProcess(10**7, 0)
    ended, sentence = emergency.stop(hangs, process, "here", stops)
    assert ended and killed == [process] and left in sentence


def pushed(one, force, seconds=2.0):
    """Pushes the tool along its axes [N]; returns the last step."""
    one.robot.set_tool_force(np.array(force))
    return events(one, seconds)[0]


@pytest.mark.parametrize("soft", [False, True])
def test_a_soft_arm_follows_yields_to_a_force_and_comes_back(soft):
    with bench(application=KNOWN, tool_weight=True) as one:
        one.soft = soft
        following(one)
        assert one.sent.count("lrSoftTool") == soft, "once, after the stiff test motion"
        events(one, 2.0)
        behind = [off(one)]
        for force in ((0.0, 0.0, 15.0), (0.0, 0.0, 0.0)):
            step = pushed(one, force)
            assert step.mode == "servo", step.reason
            behind.append(off(one))
        assert (behind[1] - behind[0] > 0.02) is soft and abs(behind[2] - behind[0]) < 0.01
        one.switch(False)
        one.run(clock.monotonic() + 20.0, "home")


def off(one):
    """Returns how far the tool is from its goal along its own z axis [m]."""
    T_goal = one.rig.kinematics.forward(one.loop.goal)
    return float((np.linalg.inv(T_goal) @ one.rig.kinematics.forward(one.robot.q))[2, 3])


def test_beyond_its_force_a_soft_arm_stops_and_says_so():
    with bench(application=KNOWN, tool_weight=True) as one:
        one.soft, one.arm._soft = True, replace(SOFT, force=10.0)
        following(one)
        step = pushed(one, (0.0, 0.0, 15.0))
        assert step.mode == "stopped" and "the controller gave up" in step.reason


def test_an_arm_whose_load_is_wrong_does_not_start_stiff_instead():
    with bench(application=ApplicationSettings(tool_mass=2.0), tool_weight=True) as one:
        one.soft = True
        one.run(clock.monotonic() + 30.0, "stopped")
        step = one.cycle()
        assert "the controller's load check fails" in step.reason and not one.controller.in_servo
        events(one, 0.5)
        assert at_rest(one)


def test_compliance_changes_at_rest_with_a_known_mass_only():
    switches = Switches()
    switches.report(Mode.SERVO, None)
    assert switches.set_soft(True).message == "The arm stays stiff: it changes at rest only, but the mode is servo."
    switches.report(Mode.HOME, None)
    assert switches.set_soft(True).success and switches.now.soft
    assert switches.set_soft(False).success and not switches.now.soft
    unknown = Switches(stiff_because="tool_mass is 0")
    unknown.report(Mode.HOME, None)
    assert unknown.set_soft(True).message == "The arm stays stiff: tool_mass is 0." and not unknown.now.soft


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [({}, "the toolbox knows stiff only"), ({"robot_server": "leap_rig", "tool_mass": 0.0}, "tool_mass is 0")],
)
def test_a_soft_arm_needs_its_server_and_its_tool(changes, sentence):
    with pytest.raises(ConfigError, match=f"compliance is soft, but {sentence}"):
        rig(RealTimeConfig, compliance="soft", **changes)


def guided(one):
    """A hand may guide the arm, as a program asked for."""
    one.hand = False
    one.run(clock.monotonic() + 20.0, "home")
    one.move = ProgramMotion(1, "there", one.arm.measured_joints, 0.0, guided=True)
    step, _ = events(one, 0.3)
    assert step.mode == "moving" and one.controller.moving, step.reason
    return one


def test_a_hand_guides_the_arm_while_it_holds_the_enabling_switch():
    with bench(application=KNOWN, tool_weight=True) as one:
        before = guided(one).robot.q
        pushed(one, (15.0, 0.0, 0.0))
        np.testing.assert_allclose(one.robot.q, before, atol=1e-6)
        one.robot.enabling = True
        step = pushed(one, (15.0, 0.0, 0.0), 0.5)
        assert step.mode == "moving" and np.max(np.abs(one.robot.q - before)) > 0.02, step.reason
        one.robot.enabling = False
        step, _ = events(one, 0.5)
        assert step.mode == "holding" and step.move.state is MoveState.DONE and at_rest(one)
        planner = MovePlanner(one.rig, {}, 0.15, 0.25, None)
        one.move = planner.plan(2, MoveGoal(one.rig.home.q), one.arm.measured_joints)
        one.run(clock.monotonic() + 20.0, "moving")


@pytest.mark.parametrize(("ends", "mode"), [("cancel", "holding"), ("off", "stopped"), ("hang", "stopped")])
def test_hand_guiding_ends_when_it_is_asked_to_and_the_arm_stays(ends, mode):
    with bench(application=KNOWN, tool_weight=True) as one:
        guided(one).robot.enabling = True
        pushed(one, (15.0, 0.0, 0.0), 0.5)
        if ends == "cancel":
            one.move = replace(one.move, cancelled=True)
        elif ends == "off":
            one.switch(False)
        else:
            clock.sleep(0.5)
        step, _ = events(one, 0.5)
        assert step.mode == mode and at_rest(one), step.reason


def test_the_toolbox_lets_no_hand_guide_the_arm():
    with bench() as one:
        one.hand = False
        one.run(clock.monotonic() + 20.0, "home")
        with pytest.raises(WrongMode, match="the robot application can"):
            one.client.start_guiding()
