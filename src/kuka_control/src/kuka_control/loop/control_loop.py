"""The part that both control loops share: a state machine from the first motion home to the last motion to zero.

    observation, now -> step: one command for the arm, and what there is to report

A cycle looks at everything that came since the last one and answers with one command; it waits for nothing. Each state
has a handler, which answers a command, or the trigger that ends the state. transitions.py has the table that says what
follows. While a motion runs, desired tool frames are disregarded; afterwards only new ones count.

After a fault the loop is latched in STOPPED: it leaves the arm where it is, says why, and continues only after control
was switched off and on again, with a motion home. And only a stream of desired tool frames that begins while control
is on is followed, so that the conditions under which a stream starts hold when the arm starts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Callable, Generic, TypeVar, Union

import numpy as np

from common.poses import read_only
from kuka_control.loop.commands import COMMANDS, Command, End, Event, Observation, Servo, StartPtp, Step, Wait
from kuka_control.loop.tracking import PtpSupervision
from kuka_control.loop.transitions import Action, State, Trigger, transitions_among
from kuka_control.model.desired_frame import DesiredFrame, DesiredStream
from kuka_control.model.switches import SwitchState
from kuka_control.model.target import Target, TargetChain
from kuka_control.model.workspace import Infeasible

Q_ZERO = read_only(np.zeros(7))  # the joints in which the arm is left behind [rad]
EXIT_PATIENCE_S = 2.0  # on exit, wait at most this long for an arm that something holds [s]

BARRED = (
    "The desired tool frame moved before control went on and does not count: take the hand out of the box and bring it "
    "in again."
)

COUNTED = (
    *("goals_sent", "limited_goals", "workspace_clips", "ik_failures", "refused_frames"),
    *("pickups", "homes", "ptp_motions", "jumps", "flips", "faults"),
)
"""The names of the counters; all are there from the start."""

MOVING = frozenset((State.HOMING, State.PICK_UP, State.RETURNING, State.ZERO))  # the states in which a PTP motion runs
WITHOUT_TARGET = MOVING - {State.PICK_UP} | {State.STOPPED}  # the states that forget the target


@dataclass(frozen=True)
class LoopSettings:
    """Settings of both loops."""

    ptp_velocity: Callable[[np.ndarray, np.ndarray, float], float]  # slows a motion whose tool would be too fast
    q_home: np.ndarray  # home position, shape (7,) [rad]
    time_out: float  # go home after this time without a new desired tool frame [s]
    velocity_home: float  # fraction of the full joint speed to home at the start and when control goes off, and to zero
    velocity_return: float  # the same to home after a time-out, and to a pick-up pose


@dataclass(frozen=True)
class Fired:
    """The trigger that ends the present state, and the detail that its reason quotes."""

    trigger: Trigger
    detail: str = ""


@dataclass(frozen=True)
class Active:
    """The present state with the data that belongs to it; a transition replaces it as a whole."""

    state: State = State.STARTING  # the state
    trigger: Trigger | None = None  # what led to it; after braking, what led to that
    because: str = ""  # why it began
    reason: str = State.STARTING.text  # the published reason
    enable_count: int = 0  # the count of enablings under which the arm left home or was stopped
    data: Any = None  # what the state works with: supervision of its motion, identification, or stream of goals


@dataclass(frozen=True)
class Cycle:
    """What a handler decides on: the observation, the desired tool frame if it is new, and the monotonic time [s]."""

    observation: Observation
    fresh: DesiredFrame | None
    now: float

    @property
    def switches(self) -> SwitchState:
        """What the operator switched."""
        return self.observation.inputs.switches


Outcome = Union[Command, Fired]
Handler = Callable[[Cycle], Outcome]
Settings = TypeVar("Settings", bound=LoopSettings)


class ControlLoop(ABC, Generic[Settings]):
    """The shared part; a subclass says how a new target is followed.

    Attributes:
        counts: of what happened so far.
        stopped_because: why the arm cannot move, a sentence; None if nothing inhibits it.
    """

    STATES: frozenset[State]  # of the algorithm; the rows of the table between them are its transitions

    PICK_UP = ""  # what a motion to a target goes to, in words

    def __init__(self, settings: Settings, chain: TargetChain) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
        self.stopped_because: str | None = None
        self._settings = settings
        self._chain = chain
        self._table = transitions_among(self.STATES)
        self._handlers: dict[State, Handler] = {
            **dict.fromkeys(MOVING, self._moving),
            State.STARTING: self._starting,
            State.HOME: self._home,
            State.AT_POSE: self._at_rest,
            State.STOPPED: self._stopped,
            State.ENDED: lambda _: End(None if self._active.trigger is Trigger.ARRIVED else self._active.because),
        }
        self._stream = DesiredStream()
        self._active = Active()
        self._target: Target | None = None
        self._infeasible: str | None = None
        self._target_stamp = 0.0
        self._unreachable: str | None = None
        self._unreachable_reported: bool | None = None
        self._enable_count = 0
        self._barred: int | None = None  # the stream of desired tool frames that ran when control went on
        # What this cycle has brought so far.
        self._events: list[Event] = []
        self._limited_by: tuple[str, ...] = ()
        self._taken: list[tuple[State, Trigger]] = []

    def step(self, observation: Observation, now: float) -> Step:
        """Returns the command of this cycle, with what there is to report; `now` is monotonic [s]."""
        self._events, self._limited_by, self._taken = [], (), []
        inputs = observation.inputs
        if inputs.switches.enable_count != self._enable_count:
            self._enable_count = inputs.switches.enable_count
            self._barred = self._stream.number if self._stream.runs else None
        update = self._stream.take(inputs.desired, inputs.clock, now, self._active.state is State.SERVO)
        if update.refused:
            self.counts["refused_frames"] += 1
            self._report("warn", update.refused)
        command = self._command(Cycle(observation, update.fresh, now))
        active = self._active
        bounds = self._target.limited_by if self._target else ()
        return Step(
            command,
            active.state.mode,
            " ".join(filter(None, (active.reason, self._inhibited_by(observation, now)))),
            tuple(self._events),
            self._target,
            bounds + self._limited_by,
            tuple(self._taken),
        )

    def _command(self, cycle: Cycle) -> Command:
        """Returns the command of the state in which the triggers of this cycle end."""
        if self._active.state in MOVING:
            cycle = replace(cycle, fresh=None)
        refused = cycle.observation.refused
        if refused is not None and (self._active.state, Trigger.REFUSED) in self._table:
            outcome: Outcome = Fired(Trigger.REFUSED, refused)
        else:
            outcome = self._handlers[self._active.state](cycle)
        while isinstance(outcome, Fired):
            outcome = self._take(outcome, cycle) or self._handlers[self._active.state](cycle)
        return outcome

    def _take(self, fired: Fired, cycle: Cycle) -> Command | None:
        """Takes a transition; returns its command, None if the next state decides in the same cycle."""
        before = self._active
        row = self._table[before.state, fired.trigger]
        self._taken.append((before.state, fired.trigger))
        moved_to = before.data.name if isinstance(before.data, PtpSupervision) else ""
        because = row.because.format(because=before.because, detail=fired.detail, name=moved_to)
        command = COMMANDS.get(row.action)
        name, velocity, data, enable_count = "", 0.0, None, before.enable_count
        if row.action is Action.PTP:
            name, q, velocity = self._motion(row.target, fired.trigger)
            velocity = self._settings.ptp_velocity(cycle.observation.joints, q, velocity)
            data, command = PtpSupervision(name, q), StartPtp(read_only(q), velocity)
            self.counts["ptp_motions"] += 1
        elif row.action is Action.HOLD:
            command = Servo(cycle.observation.joints)
        elif row.action is Action.END:
            command = End(None if fired.trigger is Trigger.ARRIVED else because)
        if row.target is State.STOPPED:
            enable_count, self.stopped_because = cycle.switches.enable_count, because
            self.counts["faults"] += 1
        elif fired.trigger is Trigger.ENABLED_AGAIN:
            self.stopped_because = None
        elif row.target is State.HOME:
            self.counts["homes"] += 1
        if row.target in WITHOUT_TARGET:
            self._target = None
        reason = row.target.text.format(because=because, name=name, velocity=velocity).strip()
        if reason:
            self._unreachable = None
            self._report("error" if row.target is State.STOPPED else "info", reason)
        cause = before.trigger if before.state is State.BRAKING else fired.trigger
        data = before.data if row.target is State.BRAKING else data
        self._active = Active(row.target, cause, because, reason or before.reason, enable_count, data)
        return command

    def _motion(self, target: State, trigger: Trigger) -> tuple[str, np.ndarray, float]:
        """Returns the goal of a motion in words and joints, and the fraction of the full joint speed."""
        settings = self._settings
        if target is State.ZERO:
            return "the zero position", Q_ZERO, settings.velocity_home
        if target is State.PICK_UP:
            assert self._target is not None and self._target.q is not None, "a motion needs a target that is reachable"
            return self.PICK_UP, self._target.q, settings.velocity_return
        late = Trigger.TIME_OUT in (trigger, self._active.trigger) and target is State.RETURNING
        return "home", settings.q_home, settings.velocity_return if late else settings.velocity_home

    def _starting(self, cycle: Cycle) -> Outcome:
        return Fired(Trigger.EXIT if self._exits(cycle) else Trigger.START)

    def _moving(self, cycle: Cycle) -> Outcome:
        """A PTP motion runs, which nothing can stop."""
        supervision: PtpSupervision = self._active.data
        if cycle.observation.arrived:
            if supervision.was_held and self._active.state is not State.ZERO:
                return Fired(Trigger.ARRIVED_AFTER_HOLD)
            return self._arrived(cycle)
        event = supervision.step(cycle.observation.joints, cycle.now)
        if supervision.held and supervision.still > EXIT_PATIENCE_S and self._exits(cycle):
            return Fired(Trigger.EXIT_WHILE_HELD)
        if event is not None:
            self._active = replace(self._active, reason=event.sentence)
            self._events.append(event)
            if supervision.held:
                self.stopped_because = event.sentence
        return Wait()

    def _arrived(self, cycle: Cycle) -> Fired:
        if self._active.state is State.PICK_UP:
            return self._leaves(cycle) or Fired(Trigger.ARRIVED)
        if self._active.state is State.ZERO and self._infeasible is not None:
            return Fired(Trigger.ARRIVED_AFTER_FAULT, self._infeasible)
        return Fired(Trigger.ARRIVED)

    def _home(self, cycle: Cycle) -> Outcome:
        if self._exits(cycle):
            return Fired(Trigger.EXIT)
        self._active = replace(self._active, enable_count=cycle.switches.enable_count)
        return self._new_target(cycle)

    def _at_rest(self, cycle: Cycle) -> Outcome:
        """No motion and no servo mode, where a motion or servo mode ended."""
        return self._leaves(cycle) or self._new_target(cycle)

    def _stopped(self, cycle: Cycle) -> Outcome:
        """A fault holds the loop until control goes off and on again."""
        if self._exits(cycle):
            return Fired(Trigger.EXIT)
        again = cycle.switches.control_on and cycle.switches.enable_count != self._active.enable_count
        return Fired(Trigger.ENABLED_AGAIN) if again else Wait()

    def _new_target(self, cycle: Cycle) -> Outcome:
        if not cycle.switches.control_on or cycle.fresh is None or self._stream.number == self._barred:
            return Wait()
        q = self._resolve(cycle.observation, cycle.fresh, cycle.observation.joints)
        return Wait() if q is None else self._follow(float(np.max(np.abs(q - cycle.observation.joints))))

    @abstractmethod
    def _follow(self, distance: float) -> Outcome:
        """Answers a new target at rest, while control is on; `distance` is that of the farthest joint [rad]."""

    def _exits(self, cycle: Cycle) -> bool:
        return cycle.switches.exit_requested or self._infeasible is not None

    def _leaves(self, cycle: Cycle) -> Fired | None:
        """Returns why the arm is to go home or to zero instead of following."""
        if self._exits(cycle):
            return Fired(Trigger.EXIT)
        if not cycle.switches.control_on:
            return Fired(Trigger.CONTROL_OFF)
        if cycle.switches.enable_count != self._active.enable_count:
            return Fired(Trigger.CONTROL_WAS_OFF)
        if self._stream.silence > self._settings.time_out:
            return Fired(Trigger.TIME_OUT, f"{self._settings.time_out:g}")
        return None

    def _resolve(self, observation: Observation, fresh: DesiredFrame, q_seed: np.ndarray) -> np.ndarray | None:
        """Returns the joints of a desired tool frame, shape (7,) [rad]; without a solution the arm keeps its own."""
        before = self._target if self._active.state is State.SERVO else None
        dt = fresh.stamp - self._target_stamp
        target = self._chain.resolve(fresh.T_base_tool, observation.inputs.switches.scale, q_seed, before, dt)
        if isinstance(target, Infeasible):
            self._infeasible = f"The controller shuts down because of the desired tool frame: {target}."
            self._report("error", self._infeasible)
            return None
        keeps = target.q is None
        self._unreachable = f"The arm keeps its joints: {target.failure}" if keeps else target.limitation
        if self._unreachable is None:
            self._unreachable_reported = None
        elif self._unreachable_reported is not keeps:
            self._unreachable_reported = keeps
            self._report("warn", self._unreachable)
        if target.q is None:
            self.counts["ik_failures"] += 1
            return None
        if target.bounds and not (self._target and self._target.bounds):
            self.counts["workspace_clips"] += 1
        self._target, self._target_stamp = target, fresh.stamp
        return target.q

    def _inhibited_by(self, observation: Observation, now: float) -> str | None:
        """Returns why incoming frames are not followed, or not exactly, although control is on; a sentence or None."""
        if not observation.inputs.switches.control_on:
            return None
        unreachable = self._unreachable if self._stream.silence <= self._settings.time_out else None
        barred = BARRED if self._stream.number == self._barred and self._stream.runs else None
        return self._stream.refusal(now) or barred or unreachable

    def _report(self, level: str, sentence: str) -> None:
        self._events.append(Event(level, sentence))
