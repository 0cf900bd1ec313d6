"""One cycle of a controller when the arm's answers fail, with a loop that always says the same."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from kst import ConnectionLost, MotionRefused, ReplyTimeout, UnexpectedReply
from kuka_control.loop.arm import ArmState
from kuka_control.loop.commands import Inputs, Servo, StartPtp, StartServo, Step, StopServo, Wait
from kuka_control.loop.controller import WARN_EVERY_S, Controller
from kuka_control.numbers import MAX_MISSED, MISSING_S, OFF_S

Q = np.zeros(7)
GOAL, PTP = Servo(Q), StartPtp(Q, 0.1)
NAN, LATE = UnexpectedReply("the controller reported `NaN_`, which is not all numbers"), ReplyTimeout("late")


class Arm:
    """Fails as `errors` say, once each, whatever it is asked; None: it does not, and joints come if `fresh`."""

    def __init__(self):
        self.errors, self.remarks = [], []
        self.silent = 0.0
        self.round_trip, self.abilities, self.carry = 0.0, frozenset(), lambda mass: None
        self.reckoned = False, 0.0
        self.state = ArmState()
        self.measured_joints, self.fresh = Q, True
        self.ptp_arrived = self.read = self.stop_servo = self.start_servo = self._ask
        self.servo = self.start_ptp = lambda *_: self._ask()

    def _ask(self):
        error = self.errors.pop(0) if self.errors else None
        if error is not None:
            raise error
        if self.fresh:
            self.measured_joints = Q.copy()
        return False

    def silence(self):
        if isinstance(self.silent, Exception):
            raise self.silent
        return self.silent

    def take_remarks(self):
        remarks, self.remarks = self.remarks, []
        return remarks


class Cycles:
    """A controller whose loop answers `command`; `said` are the events."""

    def __init__(self, command):
        self.arm, self.command = Arm(), command
        self.seen, self.said, self.now = [], [], 0.0
        self.controller = Controller(self.arm, SimpleNamespace(step=self._step))

    def run(self, *errors, dt=0.004):
        self.arm.errors = list(errors)
        for _ in range(len(errors)):
            self.now += dt
            self.said += self.controller.cycle(Inputs(), self.now).events

    def _step(self, seen, _):
        self.seen.append(seen)
        return Step(self.command, "servo", "It is tested.", ())


@pytest.mark.parametrize("error", [NAN, LATE])
@pytest.mark.parametrize("command", [GOAL, Wait()])
def test_single_bad_answers_are_counted_and_said_but_not_many_in_a_row(command, error):
    cycles = Cycles(command)
    for _ in range(3):
        cycles.run(*[error] * (3 * MAX_MISSED), None)
    assert cycles.controller.missed == 9 * MAX_MISSED
    assert [event.level for event in cycles.said] == ["warn"] and str(error) in cycles.said[0].sentence
    cycles.run(*[error] * (MAX_MISSED - 1), dt=MISSING_S)
    with pytest.raises(type(error)):
        cycles.run(error)


def test_a_goal_that_left_without_joints_is_no_answer():
    cycles = Cycles(GOAL)
    cycles.arm.fresh = False
    with pytest.raises(UnexpectedReply):
        for _ in range(MAX_MISSED):
            cycles.run(NAN, None, dt=MISSING_S / 4.0)


def test_what_is_missed_again_and_again_is_said_once_in_a_while():
    cycles = Cycles(GOAL)
    for _ in range(6):
        cycles.run(NAN, None, dt=WARN_EVERY_S / 4.0)
    assert len(cycles.said) == 3


def test_a_stop_that_is_not_confirmed_is_no_single_missed_answer():
    with pytest.raises(UnexpectedReply):
        Cycles(StopServo()).run(NAN)


def test_a_motion_that_is_not_confirmed_counts_as_refused():
    cycles = Cycles(PTP)
    cycles.run(NAN)
    assert not cycles.controller.moving
    cycles.command = Wait()
    cycles.run(None)
    assert cycles.seen[-1].refused == str(NAN)


@pytest.mark.parametrize("error", [NAN, LATE])
def test_a_motion_whose_end_could_not_be_read_runs_on(error):
    cycles = Cycles(PTP)
    cycles.run(None)
    cycles.command = Wait()
    cycles.run(error)
    assert cycles.controller.moving and cycles.controller.missed == 1 and cycles.seen[-1].refused is None


def silent(cycles, *seconds):
    """Runs a cycle for each silence of the arm [s]; returns the steps."""
    steps = []
    for cycles.arm.silent in seconds:
        cycles.now += 0.02
        steps.append(cycles.controller.cycle(Inputs(), cycles.now))
        cycles.said += steps[-1].events
    return steps


def test_a_missing_answer_holds_the_goals_and_stops_the_loop_until_it_comes():
    cycles = Cycles(GOAL)
    cycles.controller.in_servo = True
    cycles.run(None)
    steps = silent(cycles, 0.05, 0.07, 0.09)
    assert len(cycles.seen) == 1 and cycles.controller.holds == 1
    assert all(isinstance(step.command, Wait) and step.mode == "servo" for step in steps)
    assert "has not answered for 90 ms; the goals hold" in steps[-1].reason and not cycles.said
    steps = silent(cycles, 0.0, 0.0)
    assert isinstance(steps[0].command, Wait), "the wait for the answer took time that this cycle does not know"
    assert steps[1].command is GOAL and steps[1].reason == "It is tested." and not cycles.said
    silent(cycles, 0.05, 0.0)
    assert cycles.controller.holds == 2


def test_a_lost_link_is_named_within_200_ms_and_so_is_its_return():
    cycles = Cycles(GOAL)
    cycles.controller.in_servo = True
    cycles.run(None)
    silent(cycles, *(0.05 + 0.02 * i for i in range(8)))
    (said,) = cycles.said
    assert said.level == "warn" and int(re.search(r"answered for (\d+) ms", said.sentence)[1]) <= 150
    silent(cycles, 0.0)
    assert "answers again after 0.19 s" in cycles.said[-1].sentence
    assert cycles.controller.missed == cycles.controller.holds == 1


@pytest.mark.hazard(9)
@pytest.mark.parametrize(("in_servo", "off"), [(True, OFF_S), (False, 2.0 * OFF_S)])
def test_a_long_silence_switches_control_off(in_servo, off):
    cycles = Cycles(GOAL)
    cycles.controller.in_servo = in_servo
    silent(cycles, 0.99 * off)
    with pytest.raises(ReplyTimeout):
        silent(cycles, 1.01 * off)
    assert not cycles.controller.regained()
    cycles.arm.silent = 0.0
    assert cycles.controller.regained() and not cycles.controller.in_servo
    cycles.arm.silent = ConnectionLost("given up")
    with pytest.raises(ConnectionLost):
        cycles.controller.regained()


def test_servo_mode_is_left_once_the_robot_answers_and_again_if_that_fails():
    cycles = Cycles(GOAL)
    cycles.controller.in_servo = True
    cycles.arm.errors = [LATE, MotionRefused("nak")]
    assert not cycles.controller.regained() and cycles.controller.in_servo
    assert cycles.controller.regained() and not cycles.controller.in_servo


def test_a_motion_that_runs_through_a_silence_keeps_running():
    cycles = Cycles(PTP)
    cycles.run(None)
    cycles.controller.restart(cycles.arm, SimpleNamespace(step=cycles._step))
    assert cycles.controller.moving
    cycles.controller.restart(Arm(), SimpleNamespace(step=cycles._step))
    assert not cycles.controller.moving


def test_servo_mode_that_may_have_started_is_left_before_anything_else():
    cycles = Cycles(StartServo())
    with pytest.raises(ReplyTimeout):
        cycles.run(ReplyTimeout("silent", pending=True))
    assert cycles.controller.in_servo


def test_what_the_arm_has_to_say_is_said():
    cycles = Cycles(GOAL)
    cycles.arm.remarks = ["The server is old."]
    cycles.run(None, None)
    assert [(event.level, event.sentence) for event in cycles.said] == [("warn", "The server is old.")]
