"""The person who lets proposed grasps be executed and corrects them, against an arm that follows and an execution."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from following_rig import CENTER_LINE, HOME, PERIOD_S, PLAN, TOP, FollowingRig
from hypothesis import given, settings
from hypothesis import strategies as st

from common.rotations import rotation_about
from rig_simulation.operator.assisted_grasp import (
    CANCEL,
    EXECUTE,
    HIDE,
    SHOW,
    AssistedGrasp,
    AssistedView,
    GraspReport,
    ObservedObject,
    OperatorHabits,
    ProposedGrasp,
)
from rig_simulation.operator.pick_and_place import heading, turn_to, wrapped
from rig_simulation.world.scene import Cuboid, Cylinder

LOOK = {"position": np.zeros(2), "yaw": 0.0, "mass": 0.1, "friction": 0.7, "colour": np.ones(3)}
BOX = Cuboid(size=np.array([0.05, 0.12, 0.10]), **LOOK)
STEPS = (
    "look", "approach", "wait", "above", "down", "close", "lift", "hold", "lower", "open", "away", "leave", "done"
)  # fmt: skip


class Rig(FollowingRig):
    """The arm, and an execution that goes where the proposal wants it, which may be wrong.

    Attributes:
        offset: of the proposal from the object, shape (3,) [m].
        turned: heading of the proposal [rad].
        refusals: how often the execution refuses.
        slips: how often the object is not held.
    """

    def __init__(self, offset=(0.0, 0.0, 0.0), turned=0.0, wanted=None, refusals=0, slips=0):
        super().__init__()
        self.offset, self.turned, self.wanted = np.array(offset), turned, wanted
        self.refusals, self.slips = refusals, slips
        self.execution, self.reason, self.hand, self.episode, self.outcome = "idle", "", False, 0, None
        self.requests = []
        self.deaf = False

    @property
    def place(self):
        return self.top + self.offset

    def scene(self):
        turn = 0.0 if self.wanted is None else wrapped(self.wanted - self.heading, math.pi)
        return AssistedView(
            grip=self.tool,
            heading=self.heading,
            following=self.hand and not self.deaf,
            at_home=self.execution in ("idle", "over") and np.linalg.norm(self.tool - HOME) < 1e-3,
            objects={
                "far": ObservedObject(TOP + np.array([0.2, 0.0, 0.0]), 0.0),
                "thing": ObservedObject(self.top, self.top[2] - TOP[2], turn),
            },
            proposal=ProposedGrasp(7, self.place),
            execution=self.execution,
            reason=self.reason,
            outcome=self.outcome,
        )

    def request(self, name):
        """Returns the answer to EXECUTE."""
        self.requests.append(name)
        if name == EXECUTE and self.refusals:
            self.refusals -= 1
            return False, "control is off"
        if name == EXECUTE:
            self.execution = "approaching"
            self.episode += 1
        elif name == SHOW:
            self.hand = True
            self.come_in(rotation_about(2, self.heading) @ CENTER_LINE)
            self.execution = "person"
        elif name == HIDE and self.hand:
            self.hand = False
            held = self.slips == 0
            self.slips = max(0, self.slips - 1)
            self.outcome = GraspReport(self.episode, held, "the fingers pressed" if held else "no finger pressed")
            self.execution, self.curl = "over", 0.0
        return True, ""

    def advance(self):
        if self.execution == "approaching":
            above = self.place + np.array([0.0, 0.0, PLAN.grasp_height + PLAN.clearance])
            self.go(above)
            self.heading += (self.turned - self.heading) * 0.6
            if np.linalg.norm(self.tool - above) < 1e-3:
                self.execution = "waiting_for_hand"
        elif self.hand:
            if not self.deaf:
                super().advance()
        else:
            self.go(HOME)
            self.heading *= 0.7


def work(rig, rounds=1, seconds=300.0, each=lambda rig, result: None):
    """Returns the last result, the steps, and the last record of each round."""
    person, steps, ended = AssistedGrasp(OperatorHabits(rounds), PLAN, CENTER_LINE), [], {}
    for k in range(int(seconds / PERIOD_S)):
        now = k * PERIOD_S
        result = person.step(rig.scene(), now)
        ended[result.round.number] = result.round
        if not steps or steps[-1] != result.step:
            steps.append(result.step)
        if result.request:
            success, message = rig.request(result.request)
            if result.request == EXECUTE:
                person.answer(success, message, now)
        if result.move is not None:
            rig.make(result.move)
        if result.over:
            return result, steps, ended
        each(rig, result)
        rig.advance()
    pytest.fail(f"not over after {seconds} s: {steps}")


@settings(max_examples=20)
@given(st.floats(-0.03, 0.03), st.floats(-0.03, 0.03), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3))
def test_the_person_makes_good_what_the_proposal_lacks(dx, dy, turned, off):
    rig = Rig((dx, dy, 0.0), turned, wanted=turned + off)
    result, steps, ended = work(rig)
    assert not result.failure and tuple(steps) == STEPS
    grasp = ended[1]
    assert (grasp.object, grasp.executed, grasp.held, grasp.refused) == ("thing", 1, True, ())
    assert grasp.proposals == 1
    assert grasp.correction == pytest.approx(math.hypot(dx, dy), abs=2 * PLAN.tolerance)
    assert grasp.turn == pytest.approx(off, abs=PLAN.turn_tolerance + 0.02)
    assert grasp.lifted == pytest.approx(PLAN.lift, abs=2 * PLAN.tolerance)
    np.testing.assert_allclose(rig.top, TOP, atol=3 * PLAN.tolerance)
    assert rig.requests == [EXECUTE, SHOW, HIDE]


class LateRig(Rig):
    """Where the arm is comes late: as long as it waits for the hand, the person still sees it at home."""

    def scene(self):
        scene = super().scene()
        return replace(scene, grip=HOME) if self.execution == "waiting_for_hand" else scene


def test_the_correction_counts_from_where_the_hand_took_over():
    _, _, ended = work(LateRig((0.02, 0.0, 0.0)))
    assert ended[1].correction == pytest.approx(0.02, abs=2 * PLAN.tolerance)


def test_refusals_are_reported_and_outlived():
    rig = Rig(refusals=2)
    result, _, ended = work(rig)
    assert not result.failure and ended[1].refused == ("control is off",) * 2
    assert ended[1].executed == 1


def test_what_was_not_held_is_tried_again():
    rig = Rig(slips=1)
    result, _, ended = work(rig)
    assert not result.failure and ended[1].held
    assert ended[1].failed == ("the object was not held: no finger pressed",)
    assert rig.requests == [EXECUTE, SHOW, HIDE] * 2


def test_a_hand_that_is_followed_no_more_goes_out_and_tries_again():
    rig = Rig()

    def each(rig, result):
        rig.deaf = result.step == "lift" and rig.episode == 1
        rig.reason = "no frames came."

    result, _, ended = work(rig, each=each)
    assert not result.failure
    assert ended[1].failed == ("the arm stopped following the hand: no frames came",)


def who_never_arrives():
    rig = Rig()
    rig.advance = lambda: None
    return rig


@pytest.mark.parametrize(
    ("rig", "failure", "last", "requests"),
    [
        (lambda: Rig((0.06, 0.0, 0.0)), "the best grasp lies 60 mm from thing, the nearest object", "look", []),
        (lambda: Rig(refusals=1000), "control is off", "look", None),
        (lambda: Rig(slips=9), "after 3 attempts: the object was not held: no finger pressed", "leave", None),
        (who_never_arrives, "the execution is approaching", "approach", [EXECUTE, CANCEL]),
    ],
)
def test_what_fails_is_given_up_with_its_reason(rig, failure, last, requests):
    rig = rig()
    result, steps, ended = work(rig)
    assert failure in result.failure and steps[-1] == last
    assert requests is None or rig.requests == requests
    assert last != "leave" or len(ended[1].failed) == 3


def test_rounds_follow_each_other():
    rig = Rig((0.01, 0.0, 0.0))
    result, _, ended = work(rig, rounds=2)
    assert not result.failure and sorted(ended) == [1, 2]
    assert ended[1].held and ended[2].held
    assert rig.requests == [EXECUTE, SHOW, HIDE] * 2


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_a_box_is_taken_by_the_side_that_fits(yaw, fingers):
    turn = turn_to(BOX, rotation_about(2, yaw), fingers)
    assert abs(turn) <= math.pi / 2 + 1e-12
    assert abs(math.sin(fingers + turn - yaw)) < 1e-9
    square = Cuboid(size=np.array([0.05, 0.06, 0.10]), **LOOK)
    assert abs(turn_to(square, rotation_about(2, yaw), fingers)) <= math.pi / 4 + 1e-12


def test_a_round_thing_is_taken_from_any_side():
    assert turn_to(Cylinder(radius=0.03, height=0.1, **LOOK), np.eye(3), 1.0) == 0.0


def test_the_heading_of_a_tool_that_points_down():
    down = rotation_about(0, math.pi)
    assert heading(rotation_about(2, 0.7) @ down) == pytest.approx(0.7)
