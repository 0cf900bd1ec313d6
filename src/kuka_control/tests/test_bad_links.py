"""A controller on the simulated robot over bad links: far, jittery, lossy, stalled; all in virtual time."""

from __future__ import annotations

import pytest
from link_world import bench

from common import clock
from kst.session import LEAST_WINDOW_S, KstTiming
from kuka_control.loop.commands import Servo

NAMED_WITHIN_S = 0.2


@pytest.fixture
def following():
    """A bench that follows a hand; the link worsens then."""
    with bench() as one:
        one.run(clock.monotonic() + 12.0, "servo")
        yield one


def worsen(one, **way):
    for each in (one.up, one.down):
        each.worsen(**way)


LINKS = {
    "1 % loss": {"delay": 0.0005, "jitter": 0.0002, "loss": 0.01},
    "20 +- 10 ms": {"delay": 0.02, "jitter": 0.01},
    "both": {"delay": 0.02, "jitter": 0.01, "loss": 0.01},
}


@pytest.mark.hazard(7)
@pytest.mark.parametrize("link", [pytest.param("1 % loss", marks=pytest.mark.long), "20 +- 10 ms", "both"])
def test_goals_keep_their_pace_on_a_bad_link_hold_in_a_stall_and_brake(following, link):
    if link == "20 +- 10 ms":
        following.server.faults.switch("nagle")
    worsen(following, **LINKS[link])
    steps = following.follow(3.0)
    assert sum(sent for _, _, sent in steps) > 0.9 * 750
    assert not any("lost" in event.sentence for _, step, _ in steps for event in step.events)

    worsen(following, **{**LINKS[link], "loss": 0.0})
    for stall in (0.3, 0.8):
        steps += following.follow(1.0)
        steps += stalled(following, stall)
    assert {step.mode for _, step, _ in steps} == {"servo"} and following.robot.stops == 0

    following.control_on = False
    steps = following.follow(1.0)
    assert any(isinstance(step.command, Servo) for _, step, _ in steps), "it brakes by goals"
    assert steps[-1][1].mode != "servo" and following.robot.stops == 0


def stalled(one, stall):
    """Stalls the link: the goals hold within the window, the loss is named in time, and then the goals go on."""
    begin, holds = clock.monotonic(), one.controller.holds
    usual = one.client._session.usual
    one.up.stalls = one.down.stalls = [(begin, begin + stall)]
    steps = one.follow(stall)
    window = min(max(2.0 * usual, LEAST_WINDOW_S), KstTiming().servo_window)
    assert max(one.goals) < begin + window + 0.005, "goals were sent into the stall"
    (named,) = [at for at, step, _ in steps if any("lost for the moment" in event.sentence for event in step.events)]
    assert named - begin < NAMED_WITHIN_S + usual
    before = len(one.goals)
    steps += one.follow(1.0)
    assert len(one.goals) - before > 200 and one.controller.holds == holds + 1
    return steps


def test_a_link_that_stalls_with_every_loss_is_slow_but_safe(following):
    worsen(following, delay=0.0005, loss=0.01, repaired=False)
    steps = following.follow(4.0)
    assert len(following.goals) > 250 and following.controller.holds > 2
    assert {step.mode for _, step, _ in steps} == {"servo"} and following.robot.stops == 0
