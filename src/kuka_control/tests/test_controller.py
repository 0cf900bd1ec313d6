"""One cycle of a controller when the arm's answers fail, with a loop that always says the same."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from kst import MotionRefused, ReplyTimeout, UnexpectedReply
from kuka_control.loop.commands import Inputs, Servo, StartPtp, Step, StopServo, Wait
from kuka_control.loop.controller import MAX_MISSED, WARN_EVERY_S, Controller

Q = np.zeros(7)
GOAL, PTP = Servo(Q), StartPtp(Q, 0.1)
NAN, LATE = UnexpectedReply("the controller reported `NaN_`, which is not all numbers"), ReplyTimeout("late")


class Arm:
    """Fails as `errors` say, once each, whatever it is asked; None: it does not."""

    def __init__(self):
        self.errors, self.remarks = [], []
        self.measured_joints = Q
        self.ptp_arrived = self.read = self.stop_servo = self.start_servo = self._ask
        self.servo = self.start_ptp = lambda *_: self._ask()

    def _ask(self):
        error = self.errors.pop(0) if self.errors else None
        if error is not None:
            raise error
        return False

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
        cycles.run(*[error] * (MAX_MISSED - 1), None)
    assert cycles.controller.missed == 3 * (MAX_MISSED - 1)
    assert [event.level for event in cycles.said] == ["warn"] and str(error) in cycles.said[0].sentence
    with pytest.raises(type(error)):
        cycles.run(*[error] * MAX_MISSED)


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


@pytest.mark.parametrize("error", [MotionRefused("nak"), NAN, LATE])
def test_a_motion_whose_end_is_not_good_counts_as_refused(error):
    cycles = Cycles(PTP)
    cycles.run(None)
    assert cycles.controller.moving
    cycles.command = Wait()
    cycles.run(error)
    assert not cycles.controller.moving and cycles.seen[-1].refused == str(error)


def test_what_the_arm_has_to_say_is_said():
    cycles = Cycles(GOAL)
    cycles.arm.remarks = ["The server is old."]
    cycles.run(None, None)
    assert [(event.level, event.sentence) for event in cycles.said] == [("warn", "The server is old.")]
