"""The execution of a proposed grasp: why it is refused, what happens then, and how it ends, in exactly one outcome.
Nothing here moves the arm: leap_kuka holds the tool before the grasp for a hand, and an operator does the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Callable, NamedTuple

import numpy as np

from common.config import number
from common.modes import CANNOT_FOLLOW, LEAVES_TOOL, TO_DESIRED_TOOL, ExecutionState
from common.rotations import rotation_angle
from common.teleop_record import HELD, NO_HOLD, TAKEN
from grasping.execution.grasp_watch import GraspWatch, GraspWatchConfig, HandMeasurement, ObservedGrasp
from grasping.pipeline.tool_pose import ToolPoseConfig, above, grasp_in_tool, taken, tool_pose


@dataclass(frozen=True)
class ProposedPose:
    """A proposed grasp."""

    id: int  # its number
    T_base_grasp: np.ndarray | None  # shape (4, 4) [m]; None where it is unknown
    reason: str = "the camera pose is unknown"  # why it is unknown, a clause
    own_approach: bool = False  # whether the tool comes along its z axis, whatever the hand's settings say


@dataclass(frozen=True)
class ProposalList:
    """The grasps in the newest image, best first."""

    age: float  # of the image [s]
    grasps: Sequence[ProposedPose]  # what is proposed; those that the arm's controller refused come last
    reason: str = ""  # why nothing is


@dataclass(frozen=True)
class ControllerState:
    """The published state of the arm's controller: whether control is on, its mode, and the reason for it."""

    control_on: bool
    mode: str
    reason: str


@dataclass(frozen=True)
class Refusal:
    """Why no grasp is executed, one sentence."""

    sentence: str


@dataclass(frozen=True)
class ToolGoal:
    """Where the tool goes."""

    T_base_tool: np.ndarray  # the tool that takes the grasp, shape (4, 4) [m]
    T_base_above: np.ndarray  # where it waits for the hand, before the grasp along its approach, shape (4, 4) [m]
    T_base_grip: np.ndarray  # the grasp between the fingers then, shape (4, 4) [m]: x through them, z the approach


class ExecutionRequest(NamedTuple):
    """What is known when a grasp is asked for."""

    proposals: ProposalList | None  # the newest, None if none ever came
    controller: ControllerState | None  # None if it is silent
    hand_followed: bool
    fresh: float  # proposals in an older image are refused [s]


REFUSALS: tuple[tuple[Callable[..., bool], str], ...] = (
    (lambda r: r.controller is None, "The arm's controller is silent."),
    (lambda r: not r.controller.control_on, "Control of the arm is off."),
    (lambda r: r.controller.mode in CANNOT_FOLLOW, "The arm cannot go there: {r.controller.reason}"),
    (lambda r: r.hand_followed, "The arm follows a hand; take it away first."),
    (lambda r: r.proposals is None, "No grasp was proposed yet."),
    (lambda r: not -r.fresh <= r.proposals.age <= r.fresh, "The newest proposal is {r.proposals.age:.1f} s old."),
    (lambda r: not r.proposals.grasps and not r.proposals.reason, "No grasp is proposed: the list is empty."),
    (lambda r: not r.proposals.grasps, "No grasp is proposed: {r.proposals.reason}."),
    (
        lambda r: r.proposals.grasps[0].T_base_grasp is None,
        "The pose of the grasp is unknown: {r.proposals.grasps[0].reason}.",
    ),
)
"""Why a request is refused; the first row that holds counts."""


def choose(request: ExecutionRequest) -> ProposedPose | Refusal:
    """Returns the best of the newest proposals, or why none is taken."""
    for holds, sentence in REFUSALS:
        if holds(request):
            return Refusal(sentence.format(r=request))
    assert request.proposals is not None, "a row refuses it"
    return request.proposals.grasps[0]


def tool_goal(grasp: ProposedPose, settings: ToolPoseConfig, R_home: np.ndarray, up: np.ndarray) -> ToolGoal | Refusal:
    """Returns where the tool goes for a grasp whose pose is known; other arguments as in `tool_pose`."""
    assert grasp.T_base_grasp is not None, "`choose` refuses it"
    try:
        T_base_tool = tool_pose(grasp.T_base_grasp, taken(settings, grasp.own_approach), R_home, up)
    except ValueError as error:
        return Refusal(f"The hand cannot take the grasp: {error}.")
    return ToolGoal(T_base_tool, above(T_base_tool, settings.clearance), T_base_tool @ grasp_in_tool(settings))


@dataclass(frozen=True)
class ExecutionConfig:
    """The times and tolerances of an execution."""

    fresh: float = number("s", above=0.0, high=30.0, doc="proposals in an older image are refused")
    answer_time: float = number("s", above=0.0, high=30.0, doc="longest wait for an answer of another node")
    silence: float = number("s", above=0.0, high=10.0, doc="a state that is older than this is unknown")
    arrival_distance: float = number("m", above=0.0, high=0.1, doc="the tool has arrived when it is this near, and")
    arrival_angle: float = number("deg", above=0.0, high=45.0, doc="turned by no more than this")
    approach_time: float = number("s", above=0.0, high=120.0, doc="longest time for the way there")
    wait_for_hand: float = number("s", above=0.0, high=120.0, doc="how long the tool is held for a hand")
    person_time: float = number("s", above=0.0, high=3600.0, doc="longest time until the operator's grasp is decided")


@dataclass(frozen=True)
class ExecutionObservation:
    """The observed state of the rig."""

    clock: float  # ROS time [s]
    controller: ControllerState | None  # None if the arm's controller is silent
    hold: str  # HELD, TAKEN or NO_HOLD
    hold_reason: str  # leap_kuka's reason for its stream's state
    T_base_tool: np.ndarray | None  # measured tool, shape (4, 4) [m]; None if it is unknown
    hand: HandMeasurement | None  # state of the robot hand; None if it is unknown


@dataclass(frozen=True)
class ExecutionOutcome:
    """The outcome of an execution."""

    episode: int  # its number
    closed: ObservedGrasp | None  # where and when the fingers closed; None if they never did
    held: bool  # whether the hand held something while it was lifted
    reason: str  # one sentence
    release: bool  # whether the tool may still be held for a hand


class ExecutionFacts(NamedTuple):
    """What decides whether an execution continues."""

    seen: ExecutionObservation
    config: ExecutionConfig
    elapsed: float  # since the execution began [s]
    in_state: float  # since its state began [s]
    let_go: bool  # whether the tool is not held for a hand, although it was, or although it is late
    followed: bool  # whether the arm went to the grasp


_S = ExecutionState
BEFORE_HAND = (_S.APPROACHING, _S.WAITING_FOR_HAND)
RUNNING = (*BEFORE_HAND, _S.PERSON)
STOPS: tuple[tuple[tuple[ExecutionState, ...], Callable[..., bool], str], ...] = (
    (RUNNING, lambda f: f.seen.controller is None, "The arm's controller is silent"),
    (RUNNING, lambda f: not f.seen.controller.control_on, "Control of the arm was switched off"),
    (RUNNING, lambda f: f.seen.controller.mode in CANNOT_FOLLOW, "The arm stopped: {arm}"),
    (RUNNING, lambda f: f.seen.T_base_tool is None, "The pose of the tool is unknown"),
    (BEFORE_HAND, lambda f: f.let_go, "The tool was not held for a hand: {hold}"),
    (BEFORE_HAND, lambda f: f.elapsed > f.config.wait_for_hand + f.config.silence, "No hand took over in time"),
    (
        (_S.APPROACHING,),
        lambda f: f.elapsed > f.config.approach_time,
        "The tool was not before the grasp after {config.approach_time:g} s",
    ),
    ((_S.PERSON,), lambda f: f.seen.hold != TAKEN, "The operator's hand is no longer followed: {hold}"),
    ((_S.PERSON,), lambda f: f.seen.hand is None, "The state of the robot hand is unknown"),
    (
        (_S.PERSON,),
        lambda f: f.in_state > f.config.person_time,
        "Nothing was decided within {config.person_time:g} s of the operator's hand taking over",
    ),
    (RUNNING, lambda f: f.followed and f.seen.controller.mode in LEAVES_TOOL, "The arm left the grasp: {arm}"),
)
"""What ends an execution before its grasp is decided: the states in which it does, the condition on `ExecutionFacts`,
and the sentence without its full stop, with the reasons of the controller (`arm`) and of leap_kuka (`hold`). The first
row that holds counts.
"""


def stop_sentence(state: ExecutionState, facts: ExecutionFacts) -> str | None:
    """Returns why an execution in that state ends, one sentence, or None."""
    for states, holds, sentence in STOPS:
        if state in states and holds(facts):
            arm = "" if facts.seen.controller is None else facts.seen.controller.reason.rstrip(".")
            return sentence.format(arm=arm, hold=facts.seen.hold_reason, config=facts.config) + "."
    return None


class Execution:
    """The execution: its `state` (IDLE at first, OVER after each), the `reason` (one sentence: the current step, or how
    it ended) and the number of the `episode`, from 1 on. `up` is the vertical in the base frame, shape (3,).
    """

    def __init__(self, config: ExecutionConfig, watch: GraspWatchConfig, up: np.ndarray) -> None:
        self._config = config
        self._watch = GraspWatch(watch, up)
        self._T_base_above: np.ndarray | None = None
        self._began = self._since = 0.0
        self._held = self._followed = False
        self.state = ExecutionState.IDLE
        self.reason = "No grasp was executed yet."
        self.episode = 0

    @property
    def running(self) -> bool:
        return self.state not in (ExecutionState.IDLE, ExecutionState.OVER)

    def start(self, T_base_above: np.ndarray, now: float) -> None:
        """Begins at the monotonic time `now` [s]: leap_kuka holds the tool at a pose, shape (4, 4) [m]. Raises
        ValueError if an execution is running.
        """
        if self.running:
            raise ValueError(f"the execution {self.episode} is not over")
        self._T_base_above, self._began = T_base_above, now
        self._held = self._followed = False
        self.episode += 1
        self._enter(ExecutionState.APPROACHING, "The arm goes before the grasp.", now)

    def step(self, seen: ExecutionObservation, now: float) -> ExecutionOutcome | None:
        """Returns the outcome of the execution if it ends now; `now` is monotonic time [s]."""
        if not self.running:
            return None
        self._held |= seen.hold == HELD
        self._followed |= seen.controller is not None and seen.controller.mode in TO_DESIRED_TOOL
        if self.state != ExecutionState.PERSON and seen.hold == TAKEN:
            self._watch.reset()
            self._enter(ExecutionState.PERSON, "An operator's hand has taken over; close the fingers, then lift.", now)
        elapsed, in_state = now - self._began, now - self._since
        let_go = seen.hold == NO_HOLD and (self._held or elapsed > self._config.silence)
        facts = ExecutionFacts(seen, self._config, elapsed, in_state, let_go, self._followed)
        why = stop_sentence(self.state, facts)
        if why is not None:
            return self.end(why)
        assert seen.T_base_tool is not None, "an unknown tool pose ends the execution"
        if self.state == ExecutionState.PERSON:
            assert seen.hand is not None, "an unknown hand ends the operator's part"
            grasp = self._watch.step(seen.hand, seen.T_base_tool, seen.clock)
            if grasp is not None:
                return self._over(grasp, grasp.held, grasp.reason)
            if self._watch.closed:
                self.reason = "The fingers have closed; now lift."
        if self.state == ExecutionState.APPROACHING and self._arrived(seen.T_base_tool):
            self._enter(ExecutionState.WAITING_FOR_HAND, "The tool waits before the grasp for an operator's hand.", now)
        return None

    def end(self, sentence: str) -> ExecutionOutcome:
        return self._over(self._watch.give_up(sentence), False, sentence)

    def _arrived(self, T_base_tool: np.ndarray) -> bool:
        target = self._T_base_above
        assert target is not None, "an execution begins with it"
        near = np.linalg.norm(T_base_tool[:3, 3] - target[:3, 3]) <= self._config.arrival_distance
        turn = rotation_angle(target[:3, :3].T @ T_base_tool[:3, :3])
        return bool(near and np.degrees(turn) <= self._config.arrival_angle)

    def _over(self, closed: ObservedGrasp | None, held: bool, sentence: str) -> ExecutionOutcome:
        outcome = ExecutionOutcome(self.episode, closed, held, sentence, release=self.state != ExecutionState.PERSON)
        self._watch.reset()
        self.state, self.reason = ExecutionState.OVER, sentence
        return outcome

    def _enter(self, state: ExecutionState, reason: str, now: float) -> None:
        self.state, self.reason, self._since = state, reason, now
