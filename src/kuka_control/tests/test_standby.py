"""What stands in for the control loop after the robot was lost, without a robot."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from kst import ConnectionLost, NoServer, UnexpectedReply
from kuka_control.loop.commands import Observation, StartPtp, Step, Wait
from kuka_control.loop.standby import LONGEST_PAUSE_S, REMIND_S, Standby
from kuka_control.loop.stream import Desired

LOST = ConnectionLost("the link to the controller broke")
OLD = Desired(np.eye(4), 1.0)


class Loop:
    """A control loop that goes somewhere at once."""

    stopped_because = None

    def __init__(self):
        self.counts, self.seen = Counter(faults=0), []

    def step(self, seen, now):
        self.seen.append(seen)
        self.counts["ptp_motions"] += 1
        return Step(StartPtp(np.zeros(7), 0.1), "homing", "It moves.", ())


@pytest.fixture
def loops():
    return []


@pytest.fixture
def standby(loops):
    def make():
        loops.append(Loop())
        return loops[-1]

    return Standby(LOST, Counter(ptp_motions=7), make, now=100.0)


def seen(**what):
    return Observation(np.zeros(7), **what)


def test_nothing_moves_until_control_is_switched_on(standby, loops):
    standby.connected()
    for i in range(50):
        step = standby.step(seen(desired=OLD, enable_count=3), 101.0 + i)
        assert isinstance(step.command, Wait) and step.mode == "stopped" and "connected again" in step.reason
    assert not loops and standby.stopped_because
    step = standby.step(seen(desired=OLD, enable_count=4, control_on=True), 160.0)
    assert isinstance(step.command, StartPtp) and standby.stopped_because is None
    assert standby.counts == Counter(ptp_motions=8), "counters go on"
    standby.step(seen(desired=OLD, enable_count=4), 161.0)
    assert len(loops) == 1, "the loop goes on whatever the switch says"


def test_a_frame_from_before_is_not_shown_to_the_new_loop(standby, loops):
    standby.step(seen(desired=OLD), 101.0)
    new = Desired(np.eye(4), 2.0)
    for desired in (OLD, new):
        standby.step(seen(desired=desired, control_on=True), 102.0)
    assert [s.desired for s in loops[0].seen] == [None, new]


def test_a_controller_that_is_asked_to_end_goes_to_zero_by_its_loop(standby, loops):
    standby.step(seen(exit_requested=True), 101.0)
    assert loops[0].seen[0].exit_requested


def test_tries_come_ever_more_rarely_and_are_said_once_in_a_while(standby):
    now, pauses, said = standby.next_try, [], []
    while now < 100.0 + 2.5 * REMIND_S:
        said += standby.failed(NoServer("nobody listens"), now)
        pauses.append(standby.next_try - now)
        now = standby.next_try
    assert pauses[:3] == [1.0, 2.0, 4.0] and max(pauses) == pauses[-1] == LONGEST_PAUSE_S
    assert len(said) == 3 and said[0].sentence == "The robot is still gone. Try 1 failed: nobody listens."
    assert "broke" in standby.reason and f"Try {len(pauses)} failed: nobody listens." in standby.reason


@pytest.mark.parametrize(
    "error, opening",
    [(LOST, "The robot is out of reach"), (UnexpectedReply("NaN"), "The link to the robot was given up")],
)
def test_only_a_silent_robot_is_called_out_of_reach(error, opening):
    assert Standby(error, Counter(), Loop, 0.0).reason.startswith(f"{opening}: {error}. Control is off")
