"""The person who picks an object up, against an arm that follows the palm with a lag and a wrong scale."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rig_simulation.scenario.pick_and_place import STEPS, PickAndPlace, Plan, View

PERIOD_S = 0.05
PLAN = Plan()
CENTER_LINE = np.array([1.0, -1.0, 0.0])
HOME = np.array([0.42, -0.42, 0.4])
TOP = np.array([0.44, -0.38, 0.21])
# Right, up and back of a person who looks along the centre line, in the base.
RIGHT, BACK = np.array([-1.0, -1.0, 0.0]) / np.sqrt(2.0), -CENTER_LINE / np.sqrt(2.0)


class FakeRig:
    """An arm that goes where the palm goes, first order, and a cup that hangs on closed fingers near its top."""

    def __init__(self, scale=1.0, lag=0.1, top=TOP):
        self.tool, self.top, self.palm, self.curl = HOME.copy(), top.copy(), np.zeros(3), 0.0
        self._scale, self._lag = scale, lag
        self.highest = top[2]
        self.curls = []

    def make(self, move):
        self.palm, self.curl = move.palm, move.curl
        self.curls.append(move.curl)

    def advance(self):
        goal = HOME + self._scale * (np.column_stack([RIGHT, [0.0, 0.0, 1.0], BACK]) @ self.palm)
        step = (goal - self.tool) * min(1.0, PERIOD_S / self._lag)
        near = np.linalg.norm(self.tool - self.top) < PLAN.grasp_height + 0.01
        self.tool = self.tool + step
        if near and self.curl > 0.5:
            self.top = self.top + step
        self.highest = max(self.highest, self.top[2])


def work(rig, seconds=120.0, following=lambda now: True):
    person, steps = PickAndPlace(PLAN, CENTER_LINE), []
    for k in range(int(seconds / PERIOD_S)):
        now = k * PERIOD_S
        result = person.step(View(rig.tool, rig.top, rig.top[2] - TOP[2], following(now)), now)
        if not steps or steps[-1] != result.step:
            steps.append(result.step)
        if result.move is not None:
            rig.make(result.move)
        if result.over:
            return result, steps
        rig.advance()
    pytest.fail(f"not over after {seconds} s: {steps}")


@settings(max_examples=25, deadline=None)
@given(st.floats(0.6, 1.1), st.floats(0.05, 0.4), st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))
def test_the_object_is_lifted_and_put_down_where_it_stood(scale, lag, dx, dy):
    top = TOP + np.array([dx, dy, 0.0])
    rig = FakeRig(scale, lag, top)
    result, steps = work(rig)
    assert not result.failure and tuple(steps) == STEPS
    lifted = rig.highest - top[2]
    assert PLAN.lift - 2 * PLAN.tolerance < lifted < max(1.0, scale) * PLAN.lift + 2 * PLAN.tolerance
    assert_allclose(rig.top, top, atol=3 * PLAN.tolerance)
    assert rig.tool[2] - rig.top[2] > PLAN.clearance - 2 * PLAN.tolerance
    assert set(rig.curls) == {0.0, 1.0} and rig.curl == 0.0


def test_the_fingers_close_only_over_the_object():
    rig = FakeRig()
    person = PickAndPlace(PLAN, CENTER_LINE)
    now = 0.0
    while rig.curl == 0.0:
        result = person.step(View(rig.tool, rig.top, 0.0), now)
        if result.move is not None:
            rig.make(result.move)
        rig.advance()
        now += PERIOD_S
    assert_allclose(rig.tool, TOP + np.array([0.0, 0.0, PLAN.grasp_height]), atol=PLAN.tolerance)


def test_nothing_moves_while_the_arm_does_not_follow():
    rig = FakeRig()
    result, steps = work(rig, following=lambda now: False)
    assert "did not follow within 30 s" in result.failure and steps == ["wait"]
    assert not rig.curls


def test_an_arm_that_stops_on_the_way_is_given_up_with_the_reason():
    rig = FakeRig()
    rig.advance = lambda: None
    result, _ = work(rig)
    assert "away from where step 'above' wants it" in result.failure


def test_a_person_waits_out_an_interruption():
    result, steps = work(FakeRig(), following=lambda now: not 5.0 < now < 12.0)
    assert not result.failure and steps[-1] == "done"
