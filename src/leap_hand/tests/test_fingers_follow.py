"""Which hand moves the fingers: none that may not, in any order of leap_kuka's reports and of hands; and no jump."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule
from test_leap_hand import CONFIG, Player, flexion_of, hand_with, moved

from common.hand_tracking import ANY
from common.operator_rows import OLD_ROWS_S
from leap_hand.config import STEERING
from leap_hand.flexion import map_angles
from leap_hand.numbers import MAX_MISSING_S, NEAR
from leap_hand.teleop import GripperState

CLOSED, HALF, OPEN = 40.0, 65.0, 85.0  # angles of the operator's fingers [deg]
HANDS, AFTER = st.integers(0, 2), st.sampled_from([0, 1, 4, 25, 130])  # frames
RANGE = np.abs(np.diff(CONFIG.robot)[:, 0])


def shown(number=7, angle=CLOSED, left=False, place=0.0):
    hand = replace(hand_with(angle, angle, angle, 25.0), id=number, is_left=left)
    return moved(hand, np.eye(3), np.array([place, 0.0, 0.0]))


def wanted(hand):
    return map_angles(flexion_of(hand), CONFIG.human, CONFIG.robot)


class AnyOrder(RuleBasedStateMachine):
    """Three hands far from each other, a left one and two right ones, before the robot hand of an arm.

    The model knows since when each is in view, which one moved the fingers last until they open, and the newest time at
    which none might move them alone.
    """

    @initialize(follow=st.sampled_from([ANY, STEERING]), grip_hold=st.sampled_from([0.0, 0.2, 1.0]))
    def begin(self, follow, grip_hold):
        self.play = Player(hand_only=False, fingers_follow=follow, grip_hold=grip_hold)
        self.play.teleop.switch(True)
        self.follow, self.gap = follow, max(MAX_MISSING_S, grip_hold)
        self.reported, self.owner, self.keep_grip, self.alive = -np.inf, None, False, False
        self.ids, self.angles, self.newest = [1, 2, 3], [CLOSED, HALF, OPEN], 3
        self.since, self.seen, self.forbidden = [0.0] * 3, [-np.inf] * 3, -np.inf
        self.visible = set()
        self.opened()

    def opened(self):
        self.mover, self.command, self.by_steering, self.kept = None, np.zeros(4), False, np.zeros(4, dtype=bool)

    def hand(self, i):
        return shown(self.ids[i], self.angles[i], i == 0, 0.3 * i)

    @rule(i=HANDS, after=AFTER)
    def comes_or_goes(self, i, after):
        self.visible ^= {i}
        self.frames(after)

    @rule(i=HANDS, angle=st.sampled_from([CLOSED, HALF, OPEN]) | st.floats(CLOSED, OPEN), after=AFTER)
    def fingers_move(self, i, angle, after):
        self.angles[i] = angle
        self.frames(after)

    @rule(i=st.none() | HANDS, keep_grip=st.sampled_from([False, False, True]), after=AFTER)
    def report(self, i, keep_grip, after):
        self.owner, self.keep_grip, self.alive = None if i is None else (self.ids[i], i == 0), keep_grip, True
        self.say()
        self.frames(after)

    def say(self):
        """What leap_kuka does as well twice a second, as long as it is alive."""
        self.reported = self.play.now
        self.play.teleop.steered_by(self.owner, self.reported, self.keep_grip)
        if self.owner is not None or self.keep_grip:
            self.forbidden = self.reported

    @rule(
        what=st.sampled_from(["another id", "restart", "off and on", "silence", "death", "no time"]),
        i=HANDS,
        after=AFTER,
    )
    def disturbance(self, what, i, after):
        if what == "another id":
            self.newest += 1
            self.ids[i] = self.newest
        elif what == "restart":  # of the tracker; the numbers mean other hands
            self.ids = [*self.ids[1:], self.ids[0]]
            self.play.number -= 1000
            self.mover = None if self.mover is None else -1
            self.seen = [-np.inf] * 3
        elif what == "off and on":
            self.play.teleop.switch(False)
            self.play.teleop.switch(True)
            self.opened()
        elif what == "no time":  # between two frames a hand steers and no longer does
            self.owner, self.keep_grip = (self.ids[i], i == 0), False
            self.say()
            self.owner = None
            self.say()
        else:
            self.alive &= what == "silence"
            self.play.now += 0.3 if self.alive else 1.6
            result = self.play.teleop.silence(self.play.now)
            if result is not None and result.state is GripperState.OPEN:
                self.opened()
        self.frames(after)

    def frames(self, count):
        for _ in range(count):
            if self.alive and self.play.now - self.reported > 0.5:
                self.say()
            self.frame(sorted(self.visible))

    def frame(self, hands):
        now = self.play.now + 0.01
        for i in hands:
            if now - self.seen[i] > self.gap - 1e-6:
                self.since[i] = now
            self.seen[i] = now
        fresh = now - self.reported <= OLD_ROWS_S
        steers = [i for i in hands if fresh and (self.ids[i], i == 0) == self.owner]
        alone = self.follow == ANY and (self.reported == -np.inf or (fresh and not self.owner and not self.keep_grip))
        if not alone or self.by_steering:
            self.forbidden = now
        lone = [i for i in hands if alone and self.since[i] > self.forbidden and self.mover in (None, i)]
        result = self.play.step(*map(self.hand, hands))
        if result.state is GripperState.OPEN:
            assert self.mover is None or not (fresh and self.keep_grip)
            self.opened()
            return
        if result.state is GripperState.KEEPING:
            assert result.command is None and not steers
            return
        i = next(i for i in hands if result.reason.startswith(f"{self.hand(i).name} is followed"))
        assert i in steers + lone, f"hand {i} moves the fingers, but only {steers or lone} may"
        if self.mover not in (None, i):
            self.kept[:] = True
        to = wanted(self.hand(i))
        self.kept &= np.abs(to - self.command) > NEAR * RANGE
        may_differ = np.abs(result.command - self.command) > 1e-9  # a finger may also stay
        assert not np.any(may_differ & self.kept), "a jump"
        np.testing.assert_allclose(result.command[may_differ], to[may_differ], atol=1e-9)
        self.mover, self.command, self.by_steering = i, result.command, i in steers


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=100, stateful_step_count=30)


@pytest.mark.parametrize("reported", [False, True])
@pytest.mark.parametrize("follow", [ANY, STEERING])
def test_without_an_engagement_a_hand_moves_the_fingers_alone_unless_only_the_steering_one_may(follow, reported):
    play = Player(hand_only=False, fingers_follow=follow)
    play.teleop.switch(True)
    if reported:
        play.teleop.steered_by(None, play.now)
    result = play.step(shown())
    assert result.state is (GripperState.FOLLOWING if follow == ANY else GripperState.OPEN)
    np.testing.assert_allclose(result.command, wanted(shown()) * (follow == ANY), atol=1e-9)
    play.teleop.steered_by((7, False), play.now)
    np.testing.assert_allclose(play.step(shown()).command, wanted(shown()), atol=1e-9)


def test_the_hand_alone_follows_whatever_the_parameter_says():
    assert Player(hand_only=True, fingers_follow=STEERING).step(shown()).state is GripperState.FOLLOWING


@pytest.mark.hazard(17)
@pytest.mark.parametrize("left, place, both", [(True, 0.3, True), (True, 0.3, False), (False, 0.015, True)])
def test_another_hand_that_steers_takes_the_fingers_over_where_they_are(left, place, both):
    play = Player(hand_only=False)
    play.teleop.switch(True)
    play.teleop.steered_by(None, play.now)
    alone, steers = shown(), shown(9, OPEN, left, place)
    play.steps(10, alone, steers)
    play.teleop.steered_by((9, left), play.now)
    result = play.step(*[alone] * both, steers)
    assert "index, middle, thumb stay until the operator's come near" in result.reason
    np.testing.assert_allclose(result.command, wanted(alone), atol=1e-9)
    play.step(shown(9, CLOSED, left, place))
    np.testing.assert_allclose(play.step(steers).command, wanted(steers), atol=1e-9)


def test_after_an_engagement_the_hand_opens_and_only_one_that_comes_in_then_moves_it():
    play = Player(hand_only=False)
    play.teleop.switch(True)
    play.teleop.steered_by((7, False), play.now)
    other = shown(9, HALF, True, 0.3)
    play.steps(10, shown(), other)
    play.teleop.steered_by(None, play.now)
    states = [result.state for result in play.steps(60, shown(), other)]
    assert states[:19] == [GripperState.KEEPING] * 19 and set(states[21:]) == {GripperState.OPEN}
    assert "was in view already; take it away and bring it back" in play.step(shown(), other).reason
    play.steps(30, shown())
    assert play.step(shown(), other).reason == "left hand 9 is followed"


@pytest.mark.parametrize("steers", [True, False])
def test_after_a_restart_of_the_tracker_the_same_number_is_another_hand(steers):
    play = Player(hand_only=False)
    play.teleop.switch(True)
    play.teleop.steered_by(None, play.now)
    play.steps(10, shown())
    play.number -= 1000
    if steers:
        play.teleop.steered_by((7, False), play.now)
        result = play.step(shown(angle=OPEN, place=0.3))
        np.testing.assert_allclose(result.command, wanted(shown()), atol=1e-9)
    else:
        results = play.steps(30, shown(angle=OPEN, place=0.3))
        assert results[0].state is GripperState.KEEPING and results[-1].state is GripperState.OPEN
