"""The execution of a proposed grasp: what is refused, how each execution ends, and that it ends once."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common.config import parse
from common.modes import ExecutionState
from common.poses import inverse, pose, translation
from common.rotations import rotation_about
from common.teleop_record import HELD, NO_HOLD, TAKEN
from grasping.execution.execution import (
    ControllerState,
    Execution,
    ExecutionConfig,
    ExecutionObservation,
    ExecutionRequest,
    ProposalList,
    ProposedPose,
    Refusal,
    choose,
    tool_goal,
)
from grasping.execution.grasp_watch import GraspWatchConfig, HandMeasurement
from grasping.pipeline.tool_pose import ToolPoseConfig

FOLDER = Path(__file__).parents[1] / "config"
VALUES = yaml.safe_load((FOLDER / "execution.yaml").read_text())
CONFIG = parse(ExecutionConfig, VALUES, "~", others=("watch",))
WATCH = parse(GraspWatchConfig, VALUES["watch"], "~watch/")
TOOL = parse(ToolPoseConfig, yaml.safe_load((FOLDER / "tool_pose.yaml").read_text()), "~tool_pose/")
UP = np.array([0.0, 0.0, 1.0])
DOWN = np.diag([-1.0, 1.0, -1.0])
ABOVE = pose(DOWN, (0.5, 0.0, 0.4))
GRASP = ProposedPose(7, pose(DOWN, (0.5, 0.0, 0.2)))
HOME, SERVO = ControllerState(True, "home", "The arm is at home."), ControllerState(True, "servo", "It follows.")
DT = 0.05


def hand(angle=0.0, pressure=0.0, load=0.0):
    return HandMeasurement(np.full(3, angle), np.full((3, 9), pressure), np.full(3, load))


OPEN, EMPTY, FULL = hand(), hand(1.6), hand(1.2, pressure=20.0)


class Trial:
    """An execution, and what its node would hear."""

    def __init__(self):
        self.execution = Execution(CONFIG, WATCH, UP)
        self.now = 100.0
        self.seen = ExecutionObservation(1.7e9, HOME, NO_HOLD, "no hand is seen", translation(0.4, 0.0, 0.5), OPEN)
        self.outcomes = []

    def start(self):
        self.execution.start(ABOVE, self.now)
        return self

    def run(self, seconds, **changes):
        self.seen = dataclasses.replace(self.seen, **changes)
        for _ in range(max(1, round(seconds / DT))):
            self.now += DT
            self.seen = dataclasses.replace(self.seen, clock=self.seen.clock + DT)
            outcome = self.execution.step(self.seen, self.now)
            if outcome is not None:
                self.outcomes.append(outcome)
        return self

    def waiting(self):
        self.start().run(0.1).run(0.5, hold=HELD, controller=SERVO).run(0.1, T_base_tool=ABOVE)
        assert self.execution.state == ExecutionState.WAITING_FOR_HAND
        return self

    def with_person(self):
        self.waiting().run(1.0, hold=TAKEN)
        assert self.execution.state == ExecutionState.PERSON
        return self

    def lift(self, height):
        return self.run(0.1, T_base_tool=translation(0.0, 0.0, height) @ self.seen.T_base_tool)

    @property
    def outcome(self):
        assert len(self.outcomes) == 1 and self.execution.state == ExecutionState.OVER
        assert self.execution.reason == self.outcomes[0].reason
        return self.outcomes[0]


def test_a_grasp_that_is_held_and_lifted():
    trial = Trial()
    assert trial.execution.state == ExecutionState.IDLE
    trial.start()
    assert trial.execution.state == ExecutionState.APPROACHING
    trial = Trial().with_person().lift(-0.1)
    assert "close the fingers" in trial.execution.reason
    trial.run(1.0, hand=FULL)
    assert trial.execution.reason == "The fingers have closed; now lift."
    closed_at = trial.seen.T_base_tool
    outcome = trial.lift(0.06).run(2.0).outcome
    assert (outcome.held, outcome.release, outcome.episode) == (True, False, 1)
    assert outcome.reason == "The thumb and a finger felt something when the tool was 60 mm higher."
    np.testing.assert_array_equal(outcome.closed.T_base_tool, closed_at)
    assert trial.seen.clock - 4.0 < outcome.closed.time < trial.seen.clock - 2.0


GONE_HOME, LOST = ControllerState(True, "home", "Home."), {"hold": NO_HOLD, "hold_reason": "it was lost"}
OFF, STOPPED = dataclasses.replace(HOME, control_on=False), ControllerState(True, "stopped", "It hit.")
FOLLOWED, WAITING = Trial.with_person, Trial.waiting
ENDS = [  # start, what follows, the reason of the end, whether the fingers had closed
    (Trial.start, lambda t: t.run(2.1), "The tool was not held for a hand: no hand is seen.", False),
    (Trial.start, lambda t: t.run(30.1, hold=HELD), "The tool was not before the grasp after 30 s.", False),
    (Trial.start, lambda t: t.run(0.1, hold=HELD, controller=OFF), "Control of the arm was sw", False),
    (Trial.start, lambda t: t.run(0.1, hold=HELD, controller=STOPPED), "The arm stopped: It hit.", False),
    (Trial.start, lambda t: t.run(0.1, hold=HELD, controller=None), "The arm's controller is silent.", False),
    (Trial.start, lambda t: t.run(0.1, hold=HELD, T_base_tool=None), "The pose of the tool is unknown.", False),
    (WAITING, lambda t: t.run(0.1, **LOST), "for a hand: it was lost.", False),
    (WAITING, lambda t: t.run(0.1, controller=GONE_HOME), "The arm left the grasp: Home.", False),
    (WAITING, lambda t: t.run(63.0), "No hand took over in time.", False),
    (FOLLOWED, lambda t: t.run(1.0, hand=EMPTY).lift(0.06).run(2.0), "did not both feel something", True),
    (FOLLOWED, lambda t: t.run(1.0, hand=FULL).run(0.5, hand=OPEN), "opened before the tool was lifted", True),
    (FOLLOWED, lambda t: t.run(1.0, hand=FULL).lift(0.04).run(21.0), "not lifted by 50 mm in 20 s", True),
    (FOLLOWED, lambda t: t.run(1.0, hand=FULL).run(0.1, **LOST), "it was lost", True),
    (FOLLOWED, lambda t: t.run(0.1, **LOST), "no longer followed: it was lost.", False),
    (FOLLOWED, lambda t: t.run(1.0, hand=FULL).run(0.1, hand=None), "state of the robot hand is unknown", True),
    (FOLLOWED, lambda t: t.run(0.1, T_base_tool=None), "pose of the tool is unknown", False),
    (FOLLOWED, lambda t: t.run(0.1, controller=None), "controller is silent", False),
    (FOLLOWED, lambda t: t.run(0.1, controller=GONE_HOME), "left the grasp: Home.", False),
    (FOLLOWED, lambda t: t.run(181.0), "Nothing was decided within 180 s", False),
]


@pytest.mark.parametrize("begin, goes_on, reason, closed", ENDS)
def test_how_an_execution_ends(begin, goes_on, reason, closed):
    trial = begin(Trial())
    goes_on(trial)
    assert reason in trial.outcome.reason
    assert (trial.outcome.held, trial.outcome.closed is not None) == (False, closed)
    assert trial.outcome.release == (begin is not FOLLOWED), "a hand that follows is not interrupted"


def test_a_hand_that_comes_early_takes_over_on_the_way():
    trial = Trial().start().run(0.2, hold=HELD).run(0.1, hold=TAKEN)
    assert trial.execution.state == ExecutionState.PERSON


def test_an_arm_on_its_way_home_may_be_asked():
    trial = Trial().start().run(1.0, hold=HELD, controller=ControllerState(True, "returning", "Home."))
    assert trial.execution.state == ExecutionState.APPROACHING


def test_each_execution_has_its_number_and_its_outcome():
    trial = Trial().waiting()
    with pytest.raises(ValueError, match="1 is not over"):
        trial.start()
    assert trial.execution.end("The operator cancelled it.").release
    trial.with_person().run(1.0, hand=FULL)
    outcome = trial.execution.end("The node ended.")
    assert (outcome.episode, outcome.closed is not None, outcome.release) == (2, True, False)
    assert trial.run(1.0).outcomes == []


controllers = st.sampled_from(
    [HOME, SERVO, None, ControllerState(False, "home", "."), ControllerState(True, "stopped", ".")]
)
moments = st.tuples(
    controllers,
    st.sampled_from([NO_HOLD, HELD, HELD, TAKEN, TAKEN]),
    st.sampled_from([ABOVE, None, translation(0.0, 0.0, 0.1) @ ABOVE]),
    st.sampled_from([OPEN, EMPTY, FULL, None]),
    st.floats(0.05, 40.0),
)


@settings(max_examples=30)
@given(st.lists(moments, max_size=12))
def test_whatever_comes_an_execution_ends_once(moments):
    trial = Trial().start()
    for controller, hold, T_base_tool, fingers, seconds in moments:
        trial.run(seconds, controller=controller, hold=hold, T_base_tool=T_base_tool, hand=fingers)
        assert len(trial.outcomes) <= 1
        assert trial.execution.running == (not trial.outcomes)
    trial.run(CONFIG.person_time + WATCH.patience + CONFIG.wait_for_hand)
    assert len(trial.outcomes) == 1


def test_the_best_grasp_is_executed_and_no_other_in_its_place():
    best, other = ProposedPose(8, GRASP.T_base_grasp), ProposedPose(6, GRASP.T_base_grasp)
    assert choose(ExecutionRequest(ProposalList(0.3, [best, other, GRASP]), HOME, False, CONFIG.fresh)) is best
    unknown = ProposedPose(9, None, "its pose is of no use: nan")
    assert isinstance(choose(ExecutionRequest(ProposalList(0.3, [unknown, best]), HOME, False, CONFIG.fresh)), Refusal)


@pytest.mark.hazard(23)
@pytest.mark.parametrize(
    "proposals, controller, followed, sentence",
    [
        (ProposalList(0.1, [GRASP]), None, False, "The arm's controller is silent."),
        (ProposalList(0.1, [GRASP]), ControllerState(False, "home", "."), False, "Control of the arm is off."),
        *(
            (ProposalList(0.1, [GRASP]), ControllerState(True, mode, "So."), False, "The arm cannot go there: So.")
            for mode in ("starting", "zero", "stopped")
        ),
        (ProposalList(0.1, [GRASP]), SERVO, True, "The arm follows a hand; take it away first."),
        (None, HOME, False, "No grasp was proposed yet."),
        (ProposalList(2.5, [GRASP]), HOME, False, "The newest proposal is 2.5 s old."),
        (ProposalList(-9.0, [GRASP]), HOME, False, "The newest proposal is -9.0 s old."),
        (ProposalList(float("nan"), [GRASP]), HOME, False, "The newest proposal is nan s old."),
        (ProposalList(0.1, [], "no peak"), HOME, False, "No grasp is proposed: no peak."),
        (
            ProposalList(0.1, [ProposedPose(1, None)]),
            HOME,
            False,
            "The pose of the grasp is unknown: the camera pose is unknown.",
        ),
    ],
)
def test_what_is_refused(proposals, controller, followed, sentence):
    assert choose(ExecutionRequest(proposals, controller, followed, CONFIG.fresh)) == Refusal(sentence)


@pytest.mark.hazard(23)
@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5))
def test_the_tool_waits_upright_above_the_grasp_turned_as_near_to_home_as_it_can(angle, tilt):
    T_base_grasp = pose(rotation_about(2, angle) @ DOWN @ rotation_about(1, tilt), (0.5, 0.1, 0.2))
    way = tool_goal(ProposedPose(1, T_base_grasp), TOOL, DOWN, UP)
    np.testing.assert_allclose(way.T_base_above[:3, 2], -UP, atol=1e-9)
    np.testing.assert_allclose((way.T_base_above - way.T_base_tool)[:3, 3], TOOL.clearance * UP, atol=1e-9)
    np.testing.assert_allclose(way.T_base_grip[:3, 3], T_base_grasp[:3, 3], atol=1e-9)
    assert way.T_base_tool[:3, 0] @ DOWN[:, 0] >= -1e-9
    level = T_base_grasp[:2, 0] / np.linalg.norm(T_base_grasp[:2, 0])
    assert abs(way.T_base_grip[:2, 0] @ level) == pytest.approx(1.0)


def test_fingers_one_above_the_other_are_refused():
    upright = pose(rotation_about(1, np.pi / 2.0), (0.5, 0.0, 0.2))
    assert "The hand cannot take the grasp" in tool_goal(ProposedPose(1, upright), TOOL, DOWN, UP).sentence


@pytest.mark.hazard(23)
@given(st.floats(-3.1, 3.1), st.floats(-0.75, 0.75), st.floats(-0.75, 0.75))
def test_for_a_grasp_with_its_own_approach_the_tool_waits_before_it_tilted_as_it_is(angle, pitch, roll):
    R = rotation_about(2, angle) @ DOWN @ rotation_about(1, pitch) @ rotation_about(0, roll)
    T_base_grasp = pose(R, (0.5, 0.1, 0.2))
    way = tool_goal(ProposedPose(1, T_base_grasp, own_approach=True), TOOL, DOWN, UP)
    before = way.T_base_above @ inverse(way.T_base_tool) @ way.T_base_grip
    np.testing.assert_allclose(before[:3, 3], T_base_grasp[:3, 3] - TOOL.clearance * R[:, 2], atol=1e-9)
    np.testing.assert_allclose(way.T_base_above[:3, :3], way.T_base_tool[:3, :3])
    np.testing.assert_allclose(way.T_base_grip[:3, 2], R[:, 2], atol=1e-9)
    assert abs(way.T_base_grip[:3, 0] @ R[:, 0]) == pytest.approx(1.0)
    assert way.T_base_above[2, 3] > way.T_base_tool[2, 3]
