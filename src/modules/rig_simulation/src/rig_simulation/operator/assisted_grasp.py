"""The operator lets the arm move above a proposed grasp, takes over, corrects by hand, and picks the object up. The
operator waits for a proposal on an object, requests its execution, brings the hand in when the arm is above it, picks
up and puts down as in pick_and_place.py, and leaves; a failed attempt is repeated. Positions in metres in
`kuka/base_frame`, angles in radians, times in seconds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from common.modes import ExecutionState
from common.rotations import rotation_about
from rig_simulation.operator.pick_and_place import PickAndPlace, PickStep, PickView, Plan, wrapped
from rig_simulation.operator.steering import UP

EXECUTE, CANCEL, SHOW, HIDE = "execute", "cancel", "show", "hide"
"""Requests besides moves: to the execution, and for the operator's hand."""


@dataclass(frozen=True)
class OperatorHabits:
    """Parameters of the work with proposals."""

    rounds: int = 1  # number of grasps
    attempts: int = 3  # attempts at each grasp
    look: float = 2.0  # time at home before a proposal is trusted, and between two requests [s]
    reach: float = 0.05  # largest horizontal distance of a proposal from the middle of an object's top [m]
    least_lift: float = 0.1  # smallest height of a successful lift [m]
    lost: float = 2.0  # time without following after which the operator gives up an attempt [s]
    patience: float = 60.0  # longest time for one step [s]


@dataclass(frozen=True)
class ObservedObject:
    """An observed object."""

    top: np.ndarray  # centre of its upper side, shape (3,) [m]
    clearance: float  # height of its lowest point above the table [m]
    turn: float = 0.0  # required turn of the tool, see PickView


@dataclass(frozen=True)
class ProposedGrasp:
    """The best proposed grasp."""

    id: int  # its number
    position: np.ndarray  # surface point between the fingers, shape (3,) [m]


@dataclass(frozen=True)
class GraspReport:
    """The outcome of a grasp, as the execution reports it."""

    episode: int
    held: bool
    reason: str


@dataclass(frozen=True)
class AssistedView:
    """The operator's observation."""

    grip: np.ndarray  # gripping point of the tool, shape (3,) [m]
    heading: float  # of the tool [rad]
    following: bool  # whether the arm follows the hand
    at_home: bool  # whether the arm is at home
    objects: Mapping[str, ObservedObject]  # by name
    approach: np.ndarray = field(default_factory=lambda: -UP)  # of the tool, along its z axis, shape (3,)
    proposal: ProposedGrasp | None = None  # the newest best proposal that the arm reaches, or None
    complaint: str = ""  # why there is no proposal
    execution: str = ExecutionState.IDLE.value  # state of the execution
    reason: str = ""  # of that state
    outcome: GraspReport | None = None  # the newest outcome


@dataclass(frozen=True)
class Round:
    """The record of one grasp."""

    number: int  # from 1 on
    object: str = ""  # its name; empty before the choice
    proposals: int = 0  # number of different best proposals
    executed: int = 0  # number of executions
    refused: tuple[str, ...] = ()  # reasons of refused executions
    failed: tuple[str, ...] = ()  # reasons of failed attempts
    correction: float | None = None  # horizontal motion of the grip between taking over and closing the fingers [m]
    turn: float | None = None  # turn of the tool meanwhile [rad]
    lifted: float = 0.0  # greatest height above the table [m]
    held: bool | None = None  # whether the execution reports a held object; None before its report
    reason: str = ""  # of its report


@dataclass(frozen=True)
class AssistedStep(PickStep):
    """Result of a cycle: a request, a move of the hand, or nothing; `failure`: why the operator gave up."""

    round: Round = Round(1)
    request: str = ""


@dataclass
class _Attempt:
    """One attempt of a round: the work by hand, and the pose of the tool when the hand took over."""

    work: PickAndPlace
    grip: np.ndarray
    heading: float
    followed: float | None = None
    name: str = field(default="wait")


class AssistedGrasp:
    """The operator at work; call `step` about ten times a second, and after EXECUTE `answer` with the reply."""

    def __init__(self, habits: OperatorHabits, plan: Plan, center_line: np.ndarray) -> None:
        self._habits, self._plan = habits, plan
        self._center_line = np.asarray(center_line, dtype=float)
        self._round = Round(1)
        self._seen: set[int] = set()
        self._home_heading = 0.0
        self._episode: int | None = None
        self._attempt: _Attempt | None = None
        self._step = "look"
        self._since: float | None = None
        self._ready_since: float | None = None

    def answer(self, success: bool, message: str, now: float) -> None:
        if success:
            self._change(executed=self._round.executed + 1)
            self._go("approach", now)
        else:
            self._change(refused=(*self._round.refused, message))
            self._ready_since = now

    def step(self, scene: AssistedView, now: float) -> AssistedStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        if self._since is None:
            self._since = now
        if self._step == "done":
            return self._result()
        if self._attempt is None and now - self._since > self._habits.patience:
            request = CANCEL if self._step == "approach" else ""
            return self._result(request=request, failure=self._complaint(scene))
        return getattr(self, f"_{self._step}")(scene, now)

    def _look(self, scene: AssistedView, now: float) -> AssistedStep:
        if not scene.at_home or scene.following:
            self._ready_since = None
            return self._result()
        self._home_heading = scene.heading
        if self._ready_since is None:
            self._ready_since = now
        if now - self._ready_since < self._habits.look or scene.proposal is None:
            return self._result()
        if scene.proposal.id not in self._seen:
            self._seen.add(scene.proposal.id)
            self._change(proposals=self._round.proposals + 1)
        name, distance = self._nearest(scene, scene.proposal)
        if distance > self._habits.reach:
            return self._result()
        self._change(object=name, correction=None, turn=None, lifted=0.0, held=None, reason="")
        self._episode = None if scene.outcome is None else scene.outcome.episode
        return self._result(request=EXECUTE)

    def _approach(self, scene: AssistedView, now: float) -> AssistedStep:
        assert self._since is not None  # `step` sets it
        if scene.execution in (ExecutionState.IDLE, ExecutionState.OVER) and now - self._since > self._habits.look:
            return self._again(f"the execution stopped before the hand came in: {scene.reason}", now)
        if scene.execution != ExecutionState.WAITING_FOR_HAND:
            return self._result()
        turned = rotation_about(2, wrapped(scene.heading - self._home_heading))
        work = PickAndPlace(self._plan, turned @ self._center_line)
        self._attempt = _Attempt(work, scene.grip, scene.heading)
        self._go("work", now)
        return self._result(request=SHOW)

    def _work(self, scene: AssistedView, now: float) -> AssistedStep:
        seen, attempt = scene.objects[self._round.object], self._attempt
        assert attempt is not None  # `_approach` begins one
        if scene.following:
            if attempt.followed is None:
                attempt.grip, attempt.heading = scene.grip, scene.heading
            attempt.followed = now
        elif attempt.followed is not None and now - attempt.followed > self._habits.lost:
            return self._again(f"the arm stopped following the hand: {scene.reason}", now, HIDE)
        view = PickView(scene.grip, seen.top, seen.clearance, scene.following, seen.turn, scene.approach)
        result = attempt.work.step(view, now)
        if result.step == "close" and attempt.name != "close":
            shift = float(np.linalg.norm((scene.grip - attempt.grip)[:2]))
            self._change(correction=shift, turn=wrapped(scene.heading - attempt.heading))
        if result.step == "hold":
            self._change(lifted=max(self._round.lifted, seen.clearance))
        attempt.name = result.step
        if result.failure:
            return self._again(result.failure, now, HIDE)
        if result.over:
            self._attempt = None
            self._go("leave", now)
            return self._result(request=HIDE)
        return self._result(move=result.move)

    def _leave(self, scene: AssistedView, now: float) -> AssistedStep:
        outcome = scene.outcome
        if outcome is None or outcome.episode == self._episode or not scene.at_home:
            return self._result()
        self._change(held=outcome.held, reason=outcome.reason)
        if not outcome.held:
            return self._again(f"the object was not held: {outcome.reason}", now)
        if self._round.lifted < self._habits.least_lift:
            return self._again(f"the object was lifted by only {1e3 * self._round.lifted:.0f} mm", now)
        if self._round.number == self._habits.rounds:
            self._go("done", now)
            return self._result()
        ended = self._result()
        self._round = Round(self._round.number + 1)
        self._go("look", now)
        return ended

    def _again(self, why: str, now: float, request: str = "") -> AssistedStep:
        why = why.rstrip(".")
        self._change(failed=(*self._round.failed, why))
        if len(self._round.failed) >= self._habits.attempts:
            result = self._result(request=request, failure=f"after {self._habits.attempts} attempts: {why}")
        else:
            result = self._result(request=request)
            self._go("look", now)
        self._attempt = None
        return result

    def _nearest(self, scene: AssistedView, proposal: ProposedGrasp) -> tuple[str, float]:
        """Returns the object nearest to the proposal, and its horizontal distance [m]."""
        position = proposal.position[:2]
        away = {name: float(np.linalg.norm(seen.top[:2] - position)) for name, seen in scene.objects.items()}
        return min(away.items(), key=lambda item: item[1])

    def _complaint(self, scene: AssistedView) -> str:
        waited = f"step {self._step!r} took longer than {self._habits.patience:g} s"
        if self._step != "look":
            return f"{waited}: the execution is {scene.execution}: {scene.reason}"
        if not scene.at_home:
            return f"{waited}: the arm did not move home"
        if scene.proposal is None:
            return f"{waited}: no grasp is proposed: {scene.complaint}"
        if self._round.refused:
            return f"{waited}: {self._round.refused[-1]}"
        name, distance = self._nearest(scene, scene.proposal)
        return f"{waited}: the best grasp lies {1e3 * distance:.0f} mm from {name}, the nearest object"

    def _change(self, **values: Any) -> None:
        self._round = dataclasses.replace(self._round, **values)

    def _go(self, step: str, now: float) -> None:
        self._step, self._since, self._ready_since = step, now, None

    def _result(self, **what: Any) -> AssistedStep:
        name = self._attempt.name if self._attempt is not None else self._step
        return AssistedStep(name, round=self._round, **what)
