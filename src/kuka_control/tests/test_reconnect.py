"""The reconnect supervisor, without a robot."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from kst import ConnectionLost, UnexpectedReply
from kuka_control.loop.commands import Inputs, Observation, StartPtp, Step, Wait
from kuka_control.loop.controller import ReconnectSupervisor
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import SwitchState

LOST = ConnectionLost("the link to the controller broke")
OLD = DesiredFrame(np.eye(4), 1.0)


class Loop:
    """A control loop that goes somewhere at once."""

    stopped_because = None

    def __init__(self):
        self.counts, self.observations = Counter(faults=0), []
        self.calls = []

    def open_hand(self, opening):
        self.calls.append(opening)

    def step(self, observation, now):
        self.calls.append("step")
        self.observations.append(observation)
        self.counts["ptp_motions"] += 1
        return Step(StartPtp(np.zeros(7), 0.1), "homing", "It moves.", ())


@pytest.fixture
def loops():
    return []


@pytest.fixture
def supervisor(loops):
    def make():
        loops.append(Loop())
        return loops[-1]

    supervisor = ReconnectSupervisor(LOST, Counter(ptp_motions=7), make)
    assert "same connection is probed" in supervisor.reason and supervisor.next_try == np.inf
    assert [event.level for event in supervisor.lost(LOST, 100.0)] == ["error"]
    return supervisor


def observation(desired=None, **switches):
    return Observation(np.zeros(7), Inputs(desired, switches=SwitchState(**switches)))


@pytest.mark.parametrize("deaf", [True, False])
def test_only_a_server_that_may_be_deaf_is_to_be_started_again(deaf):
    (event,) = ReconnectSupervisor(LOST, Counter(), Loop, deaf).lost(LOST, 100.0)
    assert ("end MatlabToolboxServer on the smartPad" in event.sentence) is deaf
    assert "this controller tries to connect again." in event.sentence


@pytest.mark.hazard(7)
def test_nothing_moves_until_control_is_switched_on(supervisor, loops):
    supervisor.connected()
    for i in range(50):
        step = supervisor.step(observation(desired=OLD, enable_count=3), 101.0 + i)
        assert isinstance(step.command, Wait) and step.mode == "stopped" and "connected again" in step.reason
    assert not loops and supervisor.stopped_because
    step = supervisor.step(observation(desired=OLD, enable_count=4, control_on=True), 160.0)
    assert isinstance(step.command, StartPtp) and supervisor.stopped_because is None
    assert supervisor.counts == Counter(ptp_motions=8), "counters continue"
    supervisor.step(observation(desired=OLD, enable_count=4), 161.0)
    assert len(loops) == 1, "the loop continues whatever the switch says"


def test_the_fresh_loop_knows_the_hand_before_its_first_step(supervisor, loops):
    supervisor.open_hand("folded")
    supervisor.step(observation(control_on=True), 101.0)
    assert loops[0].calls == ["folded", "step"]


def test_a_frame_from_before_never_reaches_the_new_loop(supervisor, loops):
    """Reported in https://github.com/RobotLocomotion/drake-iiwa-driver/issues/38: after a broken link the arm jumps
    to old goals. Tried: reconnect.
    """
    supervisor.step(observation(desired=OLD), 101.0)
    new = DesiredFrame(np.eye(4), 2.0)
    for desired in (OLD, new):
        supervisor.step(observation(desired=desired, control_on=True), 102.0)
    assert [o.inputs.desired for o in loops[0].observations] == [None, new]


def test_a_controller_that_is_asked_to_end_goes_to_zero_by_its_loop(supervisor, loops):
    supervisor.step(observation(exit_requested=True), 101.0)
    assert loops[0].observations[0].inputs.switches.exit_requested


@pytest.mark.parametrize(
    "error, opening",
    [(LOST, "The robot is out of reach"), (UnexpectedReply("NaN"), "The link to the robot was given up")],
)
def test_only_a_silent_robot_is_called_out_of_reach(error, opening):
    supervisor = ReconnectSupervisor(error, Counter(), Loop)
    supervisor.lost(error, 0.0)
    assert supervisor.reason.startswith(f"{opening}: {error}. Control is off")


def test_a_motion_that_survived_the_silence_ends_before_control_takes_over(supervisor, loops):
    moving = Observation(np.zeros(7), Inputs(switches=SwitchState(control_on=True)), arrived=False)
    assert isinstance(supervisor.step(moving, 101.0).command, Wait) and not loops
    assert isinstance(supervisor.step(observation(control_on=True), 102.0).command, StartPtp)
