"""The person who hands a box over, against two arms that follow the palms with a lag and a wrong scale."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from following_rig import PERIOD_S
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.poses import pose
from common.rotations import rotation_about
from rig_simulation.files import read_scene
from rig_simulation.operator.hand_over import (
    GIVER,
    STEPS,
    TAKER,
    BoxHandOver,
    HandOverPlan,
    HandOverView,
    LongBox,
    between_fingers,
    fingers_at,
    roles,
)
from rig_simulation.world.scene import scene_from

PLAN = HandOverPlan()
BOX = scene_from(read_scene("hand_over")).objects["box"]
BASES = {"left": np.array([0.0, 0.45, 0.0]), "right": np.array([0.0, -0.45, 0.0])}
AHEAD = np.array([1.0, 0.0, 0.0])
R_WORLD_LEAP = np.column_stack([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]])
TABLE = scene_from(read_scene("hand_over")).table.top


class TwoFollowingArms:
    """Two arms, and a box that moves with whatever closed fingers are at one of its ends."""

    def __init__(self, scale, lag, x, y, yaw):
        self.tools = {arm: base + np.array([0.6, 0.0, 0.4]) for arm, base in BASES.items()}
        self.start = {arm: tool.copy() for arm, tool in self.tools.items()}
        self.palms, self.curls = {arm: np.zeros(3) for arm in BASES}, dict.fromkeys(BASES, 0.0)
        self.yaws = dict.fromkeys(BASES, 0.0)
        self.T = pose(rotation_about(2, yaw), (x, y, TABLE + BOX.height / 2.0))
        self.scale, self.lag = scale, lag
        self.holds, self.handed, self.slow = set(), [], 0
        self.misses, self.closed = 0, 0  # of the taker's grips, the first ones that miss; and how often it has closed

    def make(self, arm, move):
        self.closed += arm == "right" and move.curl > self.curls[arm]
        self.palms[arm], self.yaws[arm], self.curls[arm] = move.palm, move.yaw, move.curl

    def at_an_end(self, arm):
        ends = [LongBox(BOX, PLAN.from_end).top(self.T, sign) for sign in (-1.0, 1.0)]
        return min(np.linalg.norm(self.tools[arm] - end) for end in ends) < PLAN.grasp_height + 0.01

    def advance(self):
        holds = self.between_fingers
        if holds != self.holds:
            self.handed.append(holds)
        self.holds, before = holds, dict(self.tools)
        for arm, tool in before.items():
            there = self.start[arm] + self.scale * (R_WORLD_LEAP @ self.palms[arm])
            self.tools[arm] = tool + (there - tool) * min(1.0, PERIOD_S / self.lag)
        if holds:
            self.T = self.T.copy()
            self.T[:3, 3] += np.mean([self.tools[arm] - before[arm] for arm in holds], axis=0)

    @property
    def between_fingers(self):
        missed = {"right"} if self.closed <= self.misses else set()
        return {arm for arm in BASES if self.curls[arm] > 0.5 and self.at_an_end(arm)} - missed

    @property
    def touching(self):
        """The fingers that let go do so `slow` looks later than the person's."""
        holds = {arm for arm in BASES if self.curls[arm] > 0.5}
        self.seen = [*getattr(self, "seen", []), holds]
        return holds.union(*self.seen[-self.slow :]) if self.slow else holds

    @property
    def clearance(self):
        return self.T[2, 3] - BOX.height / 2.0 - TABLE


def test_the_box_is_taken_and_laid_down_within_the_workspace():
    """A tool that lays it down a little lower than it took it must not be held at the lower limit."""
    parameters = Path(__file__).parents[3] / "kuka_control" / "config" / "kuka_params_rt.yaml"
    lowest = yaml.safe_load(parameters.read_text())["z_lower_limit"]
    least = min(PLAN.grasp_height, PLAN.take_height)
    assert TABLE + BOX.height + least - 2.0 * PLAN.tolerance > lowest + 0.01


def work(rig, following=lambda now: True, seconds=200.0, each=lambda person, steps: None):
    """Lets the person work; returns the last result, the steps, and the least distance of both tools [m]."""
    who = roles(BOX, rig.T, BASES)
    person = BoxHandOver(PLAN, dict.fromkeys((GIVER, TAKER), AHEAD), BOX, who)
    steps, least = [], np.inf
    for k in range(int(seconds / PERIOD_S)):
        now = k * PERIOD_S
        grips = {role: rig.tools[arm] for role, arm in who.names.items()}
        tools = {role: rotation_about(2, np.pi - rig.yaws[arm]) for role, arm in who.names.items()}
        touching = frozenset(role for role, arm in who.names.items() if arm in rig.touching)
        holding = frozenset(role for role, arm in who.names.items() if arm in rig.between_fingers)
        view = HandOverView(grips, tools, rig.T, rig.clearance, touching, holding, following(now))
        result = person.step(view, now)
        if not steps or steps[-1] != result.step:
            steps.append(result.step)
        if result.move is not None:
            rig.make(who.names[result.who], result.move)
        if result.over:
            return result, steps, least
        rig.advance()
        each(person, steps)
        least = min(least, float(np.linalg.norm(rig.tools["left"] - rig.tools["right"])))
    pytest.fail(f"not over after {seconds} s: {steps}")


@settings(max_examples=6)
@given(st.floats(0.7, 1.1), st.floats(0.05, 0.3), st.floats(0.52, 0.58), st.floats(0.15, 0.24), st.floats(-0.2, 0.2))
@pytest.mark.parametrize("giver", ["left", "right"])
def test_the_box_goes_from_the_nearer_arm_to_the_other_and_lies_where_its_mirror_image_was(
    giver, scale, lag, x, y, yaw
):
    sign = 1.0 if giver == "left" else -1.0
    rig = TwoFollowingArms(scale, lag, x, sign * y, yaw)
    result, steps, least = work(rig)
    assert not result.failure and steps == list(STEPS)
    taker = "right" if giver == "left" else "left"
    assert rig.handed == [{giver}, {giver, taker}, {taker}, set()]
    assert_allclose(rig.T[:3, 3], [x, -sign * y, TABLE + BOX.height / 2.0], atol=5 * PLAN.tolerance)
    assert least > 0.4, "the hands stay as far apart as the ends of the box"


def test_a_box_that_lies_the_other_way_round_is_taken_at_the_outer_end_likewise():
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, np.pi)
    who = roles(BOX, rig.T, BASES)
    assert LongBox(BOX, PLAN.from_end).top(rig.T, who.end)[1] > 0.4
    result, _, _ = work(rig)
    assert not result.failure


def test_a_box_that_is_not_lifted_or_falls_is_given_up_with_the_reason():
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    rig.at_an_end = lambda arm: False
    result, steps, _ = work(rig)
    assert result.failure == "the box was not lifted" and steps[-1] == "lift"
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    at_an_end = rig.at_an_end
    rig.at_an_end = lambda arm: (arm == "left" or rig.curls["left"] > 0.5) and at_an_end(arm)  # right slips off alone

    def let_fall():
        TwoFollowingArms.advance(rig)
        if not rig.holds and len(rig.handed) > 1:
            rig.T[2, 3] = TABLE + BOX.height / 2.0

    rig.advance = let_fall
    result, steps, _ = work(rig)
    assert result.failure == f"the box fell (step {steps[-1]!r})" and steps[-1] in ("let go", "part")


def test_a_taker_that_missed_opens_goes_back_and_takes_again_before_the_giver_lets_go():
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    rig.misses = PLAN.takes - 1
    result, steps, _ = work(rig)
    taking, names = ["reach", "approach", "take"], list(STEPS)
    again = ["again", *taking]
    assert not result.failure and rig.closed == PLAN.takes
    assert steps == names[: names.index("let go")] + again * rig.misses + names[names.index("let go") :]
    assert rig.handed == [{"left"}, {"left", "right"}, {"right"}, set()]


def test_a_giver_whose_taker_keeps_missing_does_not_let_go():
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    rig.misses = PLAN.takes
    result, steps, _ = work(rig)
    assert result.failure == f"the taker did not get hold of the box, grip {PLAN.takes}"
    assert rig.closed == PLAN.takes and "let go" not in steps
    assert rig.curls["left"] == 1.0 and rig.holds == {"left"} and rig.clearance > 0.1


def test_a_giver_keeps_a_box_that_the_taker_has_at_its_fingertips():
    """While they close they push it down by 15 mm, as in the run that showed it; thumb and fingers touch it."""
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)

    def pushes(person, steps):
        if steps[-1] == "take" and not rig.pushed:
            rig.pushed, rig.T = True, pose(rig.T[:3, :3], rig.T[:3, 3] - [0.0, 0.0, 0.015])

    rig.pushed = False
    rig.at_an_end, at_an_end = lambda arm: rig.closed == 1 or at_an_end(arm), rig.at_an_end
    result, steps, _ = work(rig, each=pushes)
    names = list(STEPS)
    after = names.index("take") + 1
    assert rig.pushed and not result.failure
    assert steps == [*names[:after], "again", "reach", "approach", "take", *names[after:]]


def test_thumb_and_a_finger_hold_a_box_by_the_names_of_the_links_that_touch_it():
    touches = ["left/reflex/distal_1", "left/reflex/proximal_2", "table", "right/reflex/distal_2"]
    assert fingers_at(touches, "left") == {1, 2} and not between_fingers(touches, "left")
    palm = ["left/reflex/base_link", "left/reflex/swivel_1", "right/reflex/proximal_3"]
    assert not fingers_at(palm, "left") and not between_fingers(palm, "right")
    touches.append("right/reflex/proximal_3")
    assert between_fingers(touches, "right") and not between_fingers(touches, "left")
    assert not between_fingers(touches[-1:], "right") and not between_fingers([], "right")


def test_slow_fingers_are_waited_for():
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    rig.slow = 100
    result, steps, _ = work(rig)
    assert not result.failure and steps == list(STEPS)
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    rig.slow = 5000
    result, steps, _ = work(rig)
    assert result.failure == "step 'let go' took longer than 30 s"


def test_a_person_waits_out_an_interruption_but_not_for_ever():
    result, steps, _ = work(TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0), lambda now: not 20.0 < now < 30.0)
    assert not result.failure and steps[-1] == "done"
    result, _, _ = work(TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0), lambda now: now < 20.0)
    assert "the arms did not follow within 30 s" in result.failure


def test_a_hand_that_comes_in_anew_continues_from_where_the_tool_was_kept():
    """Its palm is in the middle again, its fingers are closed as before, and the tool has not moved."""
    rig = TwoFollowingArms(1.0, 0.1, 0.56, 0.19, 0.0)
    who = roles(BOX, rig.T, BASES)

    def again(person, steps):
        if steps[-1] == "bring" and not rig.again:
            rig.again = True
            assert person.enters(GIVER) == 1.0
            rig.palms["left"], rig.start["left"] = np.zeros(3), rig.tools["left"].copy()

    rig.again = False
    result, steps, _ = work(rig, each=again)
    assert rig.again and not result.failure and steps == list(STEPS)
    assert_allclose(rig.T[:2, 3], who.place, atol=5 * PLAN.tolerance)


def test_arms_above_each_other_have_no_middle():
    with pytest.raises(ValueError, match="are 0.00 m apart, seen from above"):
        roles(BOX, pose(p=(0.5, 0.0, 0.1)), {"left": np.zeros(3), "right": np.array([0.0, 0.0, 1.0])})
