"""The two control loops, real time and PTP: a state machine from the first motion home to the last motion to zero.

A cycle looks at everything that came since the last one and answers with one command; it waits for nothing. A state's
handler answers a command, or the trigger for the table in transitions.py. While a motion runs, desired tool frames are
disregarded; afterwards only new ones count.

After a fault the loop is latched in STOPPED: it leaves the arm where it is, says why, and continues only after control
was switched off and on again, with a motion home. Which desired tool frames count: admission.py. Motions for programs:
program_moves.py."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Callable, Generic, TypeVar, Union

import numpy as np

from common.limits import Limit
from common.poses import read_only
from iiwa_kinematics import Ball
from kuka_control.limits.motion_limits import LimitedGoal, MotionLimits, Unlimited
from kuka_control.limits.moving_arm import GuardError
from kuka_control.loop.admission import StreamAdmission
from kuka_control.loop.commands import (
    ASKED,
    COMMANDS,
    Command,
    End,
    Event,
    Observation,
    PausePtp,
    Servo,
    StartPtp,
    StartServo,
    Step,
    StopPtp,
    Wait,
)
from kuka_control.loop.giving_way import GivingWay
from kuka_control.loop.goal_stream import SETTLED_RAD, TOLERANCE_RAD, GoalStream, GoalStreamSettings, ServoStream
from kuka_control.loop.line_stream import LineStream
from kuka_control.loop.pending_check import ALLOWED, PathVerdict, PendingCheck
from kuka_control.loop.program_moves import ProgramMoves
from kuka_control.loop.servo_law import ServoLawIdentification, ServoLawVerdict, verdict
from kuka_control.loop.tracking import JointCheck, PtpSupervision, is_within
from kuka_control.loop.transitions import (
    PTP_STATES,
    REAL_TIME_STATES,
    Action,
    IfBlocked,
    State,
    Trait,
    Transition,
    Trigger,
    transitions_among,
)
from kuka_control.model.admittance import AdmittanceSettings
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.robot_shape import Opening
from kuka_control.model.switches import IN_DOUBT, ExitInPlace, SwitchState
from kuka_control.model.target import NO_OFFSET, MotionScaling, Target, TargetChain
from kuka_control.model.tool_load import ToolLoad
from kuka_control.model.workspace import Infeasible
from kuka_control.numbers import EXIT_PATIENCE_S, HAND_S, HOLD_HZ, TEST_MOTIONS

if TYPE_CHECKING:
    from kuka_control.limits.collision import CollisionGuard

Q_ZERO = read_only(np.zeros(7))  # the joints in which the arm is left behind [rad]

HELD_BACK = "The arm is in servo mode."  # instead of that it follows

COUNTED = (
    "goals_sent",
    "limited_goals",
    "goal_gaps",
    "workspace_clips",
    "ik_failures",
    "refused_frames",
    "pickups",
    "returns",
    "ptp_motions",
    "moves",
    "jumps",
    "flips",
    "faults",
)
"""The names of the counters; all are there from the start."""


@dataclass(frozen=True)
class LoopSettings:
    ptp_velocity: Callable[[np.ndarray, np.ndarray, float], float]  # slows a motion whose tool would be too fast
    q_home: np.ndarray  # home position, shape (7,) [rad]
    joint_speeds: np.ndarray  # full speeds of the joints, shape (7,) [rad/s]
    time_out: float  # go home after this time without a new desired tool frame [s]
    velocity_home: float  # fraction of the full joint speed to home at the start or after a fault, and to zero
    velocity_return: float  # the same back home when control is switched off or after a time-out, and to a pick-up pose
    guard: CollisionGuard | None  # refuses motions that come too near to a body
    torque_ranges: Callable[[np.ndarray, np.ndarray, float, float], np.ndarray] | None
    """From start, goal, velocity and payload of a PTP motion: the ranges of the external joint torques, shape (7, 2)
    [Nm], out of which the motion ends; None: it does not."""


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
    stop_count: int = 0  # the same of motions that were asked to stop, at the state's begin
    stop: Fired | None = None  # what follows once the robot has stopped the motion as it was asked to
    data: Any = None  # what the state works with: supervision of its motion, identification, or stream of goals
    at_rest: Trigger = Trigger.AT_REST  # while it brakes: the trigger once the goals are at rest

    def has(self, trait: Trait) -> bool:
        return trait in self.state.traits


@dataclass(frozen=True)
class Cycle:
    """What a handler decides on: the observation, the desired tool frame if it is new, and the monotonic time [s]."""

    observation: Observation
    fresh: DesiredFrame | None
    now: float

    @property
    def switches(self) -> SwitchState:
        return self.observation.inputs.switches


Outcome = Union[Command, Fired]
Handler = Callable[[Cycle], Outcome]
Settings = TypeVar("Settings", bound=LoopSettings)


class ControlLoop(ABC, Generic[Settings]):
    """What both loops share; a subclass says how a new target is followed.

    Attributes:
        guard_scale: fraction of the desired velocity that the collision guard leaves, 0 to 1.
        stopped_because: why the arm cannot move, a sentence; None if nothing inhibits it."""

    STATES: frozenset[State]  # of the algorithm; the rows of the table between them are its transitions

    PICK_UP = ""  # what a motion to a target goes to, in words
    NOT_COUNTED: frozenset[str] = frozenset()  # counters of the table that it leaves alone
    LEAST_RATE_HZ = 0.0  # frames that come less often are not followed [Hz]

    def __init__(self, settings: Settings, chain: TargetChain) -> None:
        self.counts: Counter[str] = Counter(dict.fromkeys(COUNTED, 0))
        self.stopped_because: str | None = None
        self.guard_scale = 1.0
        self._settings = settings
        self._chain = chain
        self._table = transitions_among(self.STATES)
        self._handlers: dict[State, Handler] = {
            **{state: self._moving for state in State if Trait.MOVES in state.traits},
            State.STARTING: self._starting,
            State.HOME: self._home,
            State.AT_POSE: self._at_rest,
            State.AT_GOAL: self._at_goal,
            State.STOPPED: self._stopped,
            State.GUIDING: self._guiding,
            State.ENDED: lambda _: End(None if self._active.trigger is Trigger.ARRIVED else self._active.because),
        }
        self._admission = StreamAdmission(settings.time_out, self.LEAST_RATE_HZ, self._away, self._report)
        self._stream = self._admission.stream
        self._active = Active()
        self._joints = JointCheck(settings.joint_speeds)
        self._target: Target | None = None
        self._infeasible: str | None = None
        self._doubt: tuple[np.ndarray, np.ndarray] | None = None  # where the arm stands whose joints are not believed
        self._target_stamp = 0.0
        self._scaling = MotionScaling()
        self._yielded = NO_OFFSET  # how far the tool that follows gives way to a force, shape (3,) [m]
        self._soft = False  # whether the servo mode is, so that forces may move the arm off its goals
        self._position = np.zeros(3)  # of the newest desired tool frame that the arm was to go to, shape (3,) [m]
        self._unreachable: str | None = None
        self._unreachable_reported: bool | None = None
        self._program = ProgramMoves(State.LINE in self.STATES)
        self._path = PendingCheck(settings.guard)
        self._opening: Opening | None = None  # of the hand
        self._started: float | None = None  # when the first cycle was [s]
        # What this cycle has brought so far.
        self._events: list[Event] = []
        self._limited_by: tuple[Limit, ...] = ()
        self._taken: list[tuple[State, Trigger]] = []

    def step(self, observation: Observation, now: float) -> Step:
        """Returns the command of this cycle, with what there is to report; `now` is monotonic [s]."""
        self._events = []
        self._limited_by = ()
        self._taken = []
        self._path.begin_cycle()
        inputs = observation.inputs
        self._program.take(inputs.move)
        self._scale(inputs.switches.scale)
        update = self._admission.take(inputs, now, self._active.state is State.SERVO)
        if update.refused:
            self.counts["refused_frames"] += 1
        command = self._command(Cycle(observation, update.fresh, now))
        if isinstance(command, Servo) and self._soft:
            self._joints.stand(None)
        elif isinstance(command, Servo):
            self._joints.follow(command.q if command.reached is None else command.reached, now)
        if self._active.has(Trait.PROGRAM):
            self._admission.program_moves(now)
        guard = self._settings.guard
        self.guard_scale = 1.0 if guard is None or Limit.COLLISION_GUARD not in self._limited_by else guard.scale
        active = self._active
        if active.has(Trait.PROGRAM):
            of_line = active.data.fraction if isinstance(active.data, LineStream) else 0.0
            self._program.advance(observation.joints, of_line)
        else:
            self._program.refuse_late(active.state.mode, active.reason, self._path.continues)
        self._path.end_cycle(bool(self._taken))
        bounds = self._target.limited_by if self._target else ()
        inhibited = self._admission.refusal(inputs.switches.control_on, active.state, now)
        why = inhibited or self._limited(observation)
        held_back = active.state is State.SERVO and why is not None
        return Step(
            command,
            active.state.mode,
            " ".join(filter(None, (HELD_BACK if held_back else active.reason, why))),
            tuple(self._events),
            self._target,
            bounds + self._limited_by,
            tuple(self._taken),
            self._program.progress,
            self._scaling,
            inhibited is not None,
        )

    @property
    def when_enabled(self) -> str | None:
        """What happens to the present desired tool frame once control is switched on; None if none comes."""
        return self._admission.when_enabled

    @property
    def exit_in_place(self) -> ExitInPlace | None:
        """Why an exit leaves the arm where it is, None if it would go to zero first."""
        touched = self._active.state is State.STOPPED and self._active.trigger is Trigger.CONTACT
        return ExitInPlace.IN_DOUBT if self._doubt is not None else ExitInPlace.TOUCHED if touched else None

    def open_hand(self, opening: Opening | None) -> None:
        """Takes over the joints of the hand; None: not known. The collision guard reckons with any."""
        self._opening = opening

    def _command(self, cycle: Cycle) -> Command:
        if self._active.has(Trait.MOVES):
            cycle = replace(cycle, fresh=None)
        observation = cycle.observation
        refused = observation.refused
        wrong = self._joints.step(observation.joints, cycle.now, observation.age)
        contact = observation.contact
        if observation.stopped is not None and (self._active.state, Trigger.STOPPED) in self._table:
            asked = self._active.stop if observation.stopped == ASKED else None
            outcome: Outcome = asked or Fired(Trigger.STOPPED, observation.stopped)
        elif contact is not None and (self._active.state, Trigger.CONTACT) in self._table:
            outcome = Fired(Trigger.CONTACT, contact)
        elif refused is None and wrong is not None and (self._active.state, Trigger.DISBELIEVED) in self._table:
            self._doubt = self._joints.where
            outcome = Fired(Trigger.DISBELIEVED, wrong)
        elif refused is not None and (self._active.state, Trigger.REFUSED) in self._table:
            outcome = Fired(Trigger.REFUSED, refused)
        else:
            outcome = self._handlers[self._active.state](cycle)
        while isinstance(outcome, Fired):
            outcome = self._take(outcome, cycle) or self._handlers[self._active.state](cycle)
        return outcome

    def _take(self, fired: Fired, cycle: Cycle) -> Command | None:
        """Takes a transition; returns its command, None if the next state decides in the same cycle."""
        before = self._active
        row = self._table[before.state, fired.trigger]
        decided, blocked = self._checked(row, cycle)
        if not decided:
            return Wait()
        if blocked is not None and row.if_blocked is IfBlocked.WAITS:
            return self._refuse_pick_up(blocked, cycle.now)
        if blocked is not None and row.if_blocked is IfBlocked.REFUSES:
            self._program.refuse(blocked)
            return Wait()
        if blocked is not None and row.if_blocked.trigger is not None:
            fired = Fired(row.if_blocked.trigger, blocked)
            row = self._table[before.state, fired.trigger]
        self._taken.append((before.state, fired.trigger))
        moved_to = before.data.name if isinstance(before.data, PtpSupervision) else ""
        because = row.because.format(because=before.because, detail=fired.detail, name=moved_to)
        command = COMMANDS.get(row.action)
        name = ""
        velocity = 0.0
        data = before.data if Trait.BRAKES in row.target.traits else None
        if row.action is Action.PTP:
            name, q, velocity = self._motion(row.target)
            velocity = self._settings.ptp_velocity(cycle.observation.joints, q, velocity)
            torques = self._settings.torque_ranges
            ranges = torques and torques(cycle.observation.joints, q, velocity, cycle.switches.payload)
            data = PtpSupervision(name, q)
            command = StartPtp(read_only(q), velocity, ranges)
            self.counts["ptp_motions"] += 1
            self._admission.own.note(before.state, row.target, (before.trigger, fired.trigger), cycle.now)
        elif row.action is Action.START_SERVO:
            self._soft = cycle.switches.soft and Trait.STREAMS in row.target.traits  # its servo law shows only stiff
            command = StartServo(self._soft)
        elif row.action is Action.END:
            command = End(None if fired.trigger is Trigger.ARRIVED else because)
        if row.counted and row.counted not in self.NOT_COUNTED:
            self.counts[row.counted] += 1
        traits = row.target.traits
        cause = before.trigger if before.has(Trait.BRAKES) else fired.trigger
        if before.has(Trait.PROGRAM) and Trait.PROGRAM not in traits:
            self._program.end(row.target, cause if fired.trigger is Trigger.AT_REST else fired.trigger, because)
        elif Trait.PROGRAM in traits and not before.has(Trait.PROGRAM):
            self._admission.own.forget()
        latches = Trait.LATCHES in traits
        if latches:
            self.stopped_because = because
            self._infeasible = None
            self.counts["faults"] += 1
        elif fired.trigger is Trigger.ENABLED_AGAIN:
            self.stopped_because = None
        if Trait.FORGETS in traits:
            self._target = None
        if Trait.FOLLOWS in traits:
            self._admission.followed(cycle.now)
        if Trait.MOVES in traits or latches or row.target is State.GUIDING:
            self._joints.stand(None)
        reason = row.target.text.format(because=because, name=name, velocity=velocity).strip()
        if reason:
            self._unreachable = None
            self._report("error" if latches else "info", reason)
        enable_count = cycle.switches.enable_count if latches else before.enable_count
        self._active = Active(
            *(row.target, cause, because, reason or before.reason, enable_count, cycle.switches.stop_count),
            data=data,
            at_rest=row.at_rest,
        )
        return command

    def _motion(self, target: State) -> tuple[str, np.ndarray, float]:
        """Returns the goal of a motion in words and joints, and the fraction of the full joint speed."""
        settings = self._settings
        if target is State.ZERO:
            return "the zero position", Q_ZERO, settings.velocity_home
        if target is State.PICK_UP:
            assert self._target is not None and self._target.q is not None, "a motion needs a target that is reachable"
            slow = self._admission.ran_before
            return self.PICK_UP, self._target.q, settings.velocity_home if slow else settings.velocity_return
        if target is State.TO_GOAL:
            move = self._program.running
            return move.name, move.q, move.velocity
        velocity = settings.velocity_return if target is State.RETURNING else settings.velocity_home
        return "home", settings.q_home, velocity

    def _checked(self, row: Transition, cycle: Cycle) -> PathVerdict:
        """Returns whether a motion that a transition begins may begin."""
        if row.action is Action.PTP:
            name, q, _ = self._motion(row.target)
            return self._path.ask(f"motion to {name}", (cycle.observation.joints, q), False)
        if row.target is State.LINE:
            return self._path.ask("line", self._program.line.path, True)
        return ALLOWED

    def _away(self, T_base_tool: np.ndarray) -> tuple[float, float]:
        """Returns how far a desired tool frame, shape (4, 4) [m], is from the tool at home: [m], [rad]."""
        return self._chain.away(T_base_tool, self._scaling, self._settings.q_home)

    def _scale(self, factor: float) -> None:
        """Takes the scaling factor over; where the arm follows, about its present pose."""
        if not self._active.has(Trait.SCALES_HERE):
            self._scaling = MotionScaling(factor)
        elif factor != self._scaling.factor:
            self._scaling = self._chain.rescaled(self._scaling, factor, self._position)

    def _refuse_pick_up(self, blocked: str, now: float) -> Command:
        self._admission.block(blocked, now)
        return Wait()

    def _starting(self, cycle: Cycle) -> Outcome:
        """With the collision guard the hand has a moment to report: its sensors' rest is taken before the arm moves."""
        if self._exits(cycle):
            return Fired(Trigger.EXIT)
        self._started = cycle.now if self._started is None else self._started
        unknown = self._settings.guard is not None and self._opening is None
        return Wait() if unknown and cycle.now - self._started < HAND_S else Fired(Trigger.START)

    def _moving(self, cycle: Cycle) -> Outcome:
        """A PTP motion runs, which ends early only where the robot can stop it."""
        supervision: PtpSupervision = self._active.data
        if cycle.observation.arrived:
            leaves = self._active.state is State.ZERO
            if supervision.was_held and not leaves:
                return Fired(Trigger.ARRIVED_AFTER_HOLD)
            if not leaves and not supervision.is_at_goal(cycle.observation.joints):
                wrong = supervision.ended_elsewhere(cycle.observation.joints, cycle.now)
                self._doubt = None if wrong is None else (supervision.q, supervision.q)
                return Wait() if wrong is None else Fired(Trigger.DISBELIEVED, wrong)
            self._joints.stand(supervision.q)
            return self._arrived(cycle)
        if self._stops(cycle, f"the motion to {supervision.name}"):
            return StopPtp()
        paused = self._paused(cycle, supervision)
        if paused is not None:
            return paused
        event = supervision.step(cycle.observation.joints, cycle.now)
        if supervision.held and supervision.still > EXIT_PATIENCE_S and self._exits(cycle):
            return Fired(Trigger.EXIT_WHILE_HELD)
        if event is not None:
            self._active = replace(self._active, reason=event.sentence)
            self._events.append(event)
            if supervision.held:
                self.stopped_because = event.sentence
        return Wait()

    def _guiding(self, cycle: Cycle) -> Outcome:
        if cycle.observation.arrived:
            self._joints.stand(cycle.observation.joints)
            return Fired(Trigger.ARRIVED)
        return StopPtp() if self._stops(cycle, "the hand guiding") else Wait()

    def _stops(self, cycle: Cycle, what: str) -> bool:
        """Returns whether the robot is to stop a motion now, and notes what is to follow."""
        stop = self._stop_asked(cycle)
        if stop is not None:
            reason = f"The robot stops {what}: {stop.detail}."
            self._active = replace(self._active, stop_count=cycle.switches.stop_count, stop=stop, reason=reason)
        return stop is not None

    def _stop_asked(self, cycle: Cycle) -> Fired | None:
        """Returns what is to follow once the robot has stopped the motion; None: it is not asked to do so now."""
        if not cycle.observation.stops:
            return None
        if cycle.switches.stop_count != self._active.stop_count:
            return Fired(Trigger.STOPPED, cycle.switches.stop_because)
        if self._active.stop is None and self._active.has(Trait.PROGRAM) and self._program.cancelled:
            return Fired(Trigger.CANCELLED, "the program cancelled it")
        if self._active.stop is None and self._active.state is State.GUIDING and self._exits(cycle):
            return Fired(Trigger.CANCELLED, "the controller is to exit")
        return None

    def _paused(self, cycle: Cycle, supervision: PtpSupervision) -> Command | None:
        """Pauses and continues the PTP motion as the operator asks for it, until the robot has done so."""
        wanted, paused = cycle.switches.paused and cycle.observation.stops, cycle.observation.paused
        if not (wanted or paused):
            return None
        if wanted:
            reason = f"The motion to {supervision.name} is paused; kuka/pause continues it, control off ends it."
        else:
            reason = f"The motion to {supervision.name} continues."
        fresh = PtpSupervision(supervision.name, supervision.q)  # an arm that is paused is not held by anything
        self._active = replace(self._active, reason=reason, data=fresh)
        return Wait() if wanted and paused else PausePtp(wanted)

    def _arrived(self, cycle: Cycle) -> Fired:
        if self._active.state is State.PICK_UP:
            return self._leaves(cycle) or Fired(Trigger.ARRIVED)
        return Fired(Trigger.ARRIVED)

    def _home(self, cycle: Cycle) -> Outcome:
        self._active = replace(self._active, enable_count=cycle.switches.enable_count)
        return self._ends(cycle) or self._new_move(cycle) or self._toward_stream(cycle)

    def _at_goal(self, cycle: Cycle) -> Outcome:
        """The arm stays where a motion for a program ended; no frame is awaited, so none is late."""
        return self._switched(cycle) or self._new_move(cycle) or self._toward_stream(cycle)

    def _at_rest(self, cycle: Cycle) -> Outcome:
        """No motion and no servo mode, where a motion or servo mode ended."""
        return self._leaves(cycle) or self._toward_stream(cycle)

    def _stopped(self, cycle: Cycle) -> Outcome:
        """A fault holds the loop until control is switched off and on again; no motion begins at joints in doubt."""
        if self._doubt is not None and is_within(cycle.observation.joints, self._doubt):
            self._doubt = None
            self._report("info", "The measured joints are believed again.")
        if self._exits(cycle):
            stays = self.exit_in_place or cycle.switches.exit_in_place
            where = None if stays is None else f"The arm stays where it is: {stays.value}."
            return Fired(Trigger.EXIT) if where is None else Fired(Trigger.EXIT_BLOCKED, where)
        again = cycle.switches.control_on and cycle.switches.enable_count != self._active.enable_count
        if again and self._doubt is not None:
            self._active = replace(self._active, enable_count=cycle.switches.enable_count)
            self._report("error", f"Nothing moves: {IN_DOUBT}")
        return Fired(Trigger.ENABLED_AGAIN) if again and self._doubt is None else Wait()

    def _toward_stream(self, cycle: Cycle) -> Outcome:
        if not cycle.switches.control_on or not self._admission.admitted:
            return Wait()
        if self._admission.decided and self._target is not None and self._path.goes_to(self._target.q):
            return Fired(Trigger.FAR_TARGET)
        if cycle.fresh is None or not self._admission.admits(cycle.fresh, cycle.now):
            return Wait()
        q = self._resolve(cycle.fresh, cycle.observation.joints)
        if q is None:
            return Wait()
        outcome = self._follow(float(np.max(np.abs(q - cycle.observation.joints))))
        if not isinstance(outcome, Fired):
            return outcome
        repeats = self._admission.repeats(self._active.state, outcome.trigger, cycle.fresh, cycle.now)
        return Wait() if repeats else outcome

    def _new_move(self, cycle: Cycle) -> Fired | None:
        trigger = self._program.begin(cycle.observation.joints, cycle.switches.control_on, self._stream.runs)
        return None if trigger is None else Fired(trigger)

    @abstractmethod
    def _follow(self, distance: float) -> Outcome:
        """Answers a new target at rest, while control is on; `distance` is that of the farthest joint [rad]."""

    def _exits(self, cycle: Cycle) -> bool:
        return cycle.switches.exit_requested

    def _ends(self, cycle: Cycle) -> Fired | None:
        """Returns why the program ends: where the arm stands, if a frame is infeasible."""
        if self._infeasible is not None:
            return Fired(Trigger.INFEASIBLE, self._infeasible)
        return Fired(Trigger.EXIT) if self._exits(cycle) else None

    def _switched(self, cycle: Cycle) -> Fired | None:
        ends = self._ends(cycle)
        if ends is not None:
            return ends
        if not cycle.switches.control_on:
            return Fired(Trigger.CONTROL_OFF)
        if cycle.switches.enable_count != self._active.enable_count:
            return Fired(Trigger.CONTROL_WAS_OFF)
        return None

    def _leaves(self, cycle: Cycle) -> Fired | None:
        switched = self._switched(cycle)
        if switched is not None:
            return switched
        if self._stream.silence > self._settings.time_out:
            return Fired(Trigger.TIME_OUT, f"{self._settings.time_out:g}")
        return None

    def _resolve(self, fresh: DesiredFrame, q_seed: np.ndarray) -> np.ndarray | None:
        """Returns the joints of a desired tool frame, shape (7,) [rad]; without a solution the arm keeps its own."""
        servo = self._active.state is State.SERVO
        rests = servo and self._admission.rare is not None
        before = self._target if servo and not rests else None
        dt = fresh.stamp - self._target_stamp
        self._position = fresh.T_base_tool[:3, 3]
        scaling = MotionScaling(self._scaling.factor, self._scaling.offset + self._yielded) if servo else self._scaling
        target = self._chain.resolve(fresh.T_base_tool, scaling, q_seed, before, dt)
        if isinstance(target, Infeasible) and self._yielded.any():  # a force ends no controller
            target = self._chain.resolve(fresh.T_base_tool, self._scaling, q_seed, before, dt)
        if isinstance(target, Infeasible):
            self._infeasible = f"The controller shuts down because of the desired tool frame: {target}."
            self._report("error", self._infeasible)
            return None
        keeps = target.q is None
        self._unreachable = f"The arm keeps its joints: {target.failure}" if keeps else target.limitation
        if rests:  # nothing is followed, so nothing yields
            self._unreachable = None
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
        self._target = target
        self._target_stamp = fresh.stamp
        return target.q

    def _limited(self, observation: Observation) -> str | None:
        """Returns why frames are not followed exactly, or that none comes, a sentence, or None."""
        if not observation.inputs.switches.control_on:
            return None
        if not self._stream.runs:
            return observation.inputs.missing if self._active.state is State.HOME else None
        if self._stream.silence > self._settings.time_out:
            return None
        outside = self._target.outside if self._target and self._active.has(Trait.SCALES_HERE) else None
        return self._unreachable or outside or self._held_back()

    def _held_back(self) -> str | None:
        """Returns what the collision guard keeps the arm away from, a sentence, if it acted in this cycle."""
        guard = self._settings.guard
        if guard is None or guard.nearest is None or Limit.COLLISION_GUARD not in self._limited_by:
            return None
        return f"The collision guard holds the arm back: {guard.nearest}."

    def _report(self, level: str, sentence: str) -> None:
        self._events.append(Event(level, sentence))


@dataclass(frozen=True)
class RealTimeSettings(LoopSettings):
    servo_law: str  # law of the robot's servo loop that the goals are to be made for, "auto", "lts" or "none"
    goals: GoalStreamSettings  # the settings of the stream of goals
    carried: Callable[[Opening | None], Iterable[Ball]]  # what the flange carries at an opening of the hand
    gives_way: tuple[AdmittanceSettings, ToolLoad] | None  # how the tool that follows yields to a force; None: not


class RealTimeLoop(ControlLoop[RealTimeSettings]):
    """Picks the desired tool frame up by a PTP motion, then follows it by servo goals. Before the first stream a
    small motion at home identifies the servo law of the robot's controller. Goals that are meant for another law
    would be wrong by far, so then the controller exits without having followed anything."""

    STATES = REAL_TIME_STATES
    PICK_UP = "the pick-up pose"
    LEAST_RATE_HZ = HOLD_HZ

    def __init__(self, settings: RealTimeSettings, chain: TargetChain, limits: MotionLimits | Unlimited) -> None:
        super().__init__(settings, chain)
        self._limits = limits
        self._way = None if settings.gives_way is None else GivingWay(*settings.gives_way)
        self._law: ServoLawVerdict | None = None
        self._test_motions = 0
        self._handlers.update(
            {
                State.IDENTIFYING: self._identifying,
                State.IDENTIFIED: self._identified,
                State.SERVO: self._servo,
                State.BRAKING: self._braking,
                State.SERVO_LEFT: self._at_rest,
                State.RETURN_PENDING: self._return_pending,
                State.LINE: self._line,
                State.LINE_BRAKING: self._braking,
            }
        )

    @property
    def goal(self) -> np.ndarray:
        """The joints where the stream is, shape (7,) [rad]; what is sent may differ for the servo law."""
        return self._limits.goal

    def open_hand(self, opening: Opening | None) -> None:
        """As for all loops; the speed limits of the stream hold for the finger tips, too."""
        if opening != self._opening:
            self._limits.carry(self._settings.carried(opening))
        super().open_hand(opening)

    def _arrived(self, cycle: Cycle) -> Fired:
        if self._active.state is State.HOMING and self._law is None and not self._exits(cycle):
            return Fired(Trigger.ARRIVED_UNIDENTIFIED)
        return super()._arrived(cycle)

    def _identifying(self, cycle: Cycle) -> Outcome:
        joints = cycle.observation.joints
        if self._active.data is None:
            self._active = replace(self._active, data=ServoLawIdentification(joints))
        identification: ServoLawIdentification = self._active.data
        goal, result = identification.step(joints, cycle.now)
        if result is None:
            return Servo(goal)
        self._test_motions += 1
        again = self._test_motions < TEST_MOTIONS and not self._exits(cycle)
        if again and result.badly_seen and self._settings.servo_law == "auto":
            self._active = replace(self._active, data=ServoLawIdentification(identification.rest))
            return Servo(goal)
        self._law = verdict(result, self._settings.servo_law)
        if not self._law.refused:
            self._report(self._law.level, self._law.sentence)
        return Fired(Trigger.LAW_IDENTIFIED)

    def _identified(self, cycle: Cycle) -> Outcome:
        if self._law is not None and self._law.refused:
            return Fired(Trigger.WRONG_LAW, self._law.sentence)
        return Fired(Trigger.SERVO_ENDED)

    def _return_pending(self, cycle: Cycle) -> Outcome:
        return Fired(Trigger.EXIT if self._exits(cycle) else Trigger.SERVO_ENDED)

    def _follow(self, distance: float) -> Outcome:
        if distance <= TOLERANCE_RAD:
            return Fired(Trigger.NEAR_TARGET)
        return Fired(Trigger.FAR_TARGET)

    def _servo(self, cycle: Cycle) -> Outcome:
        leaves = self._leaves(cycle)
        if leaves is not None:
            return leaves
        if self._admission.rejection is not None:
            return Fired(Trigger.CONFLICT, self._admission.rejection)
        joints = cycle.observation.joints
        if self._active.data is None:
            lts = self._law is not None and self._law.lts and not self._soft
            stream = GoalStream(self._settings.goals, self._limits, lts, joints, cycle.now)
            self._active = replace(self._active, data=stream)
            self._yielded = NO_OFFSET
            if self._way is not None:
                self._way.begin(cycle.now)
        goals: GoalStream = self._active.data
        lag = self._lag(goals, cycle)
        if lag is not None:
            return Fired(Trigger.LAG, lag)
        stamp = None
        if cycle.fresh is not None:
            stall = goals.hear(cycle.fresh, cycle.now)
            self._admission.hear_rate(goals.too_rare)
            self._give_way(cycle)
            q = self._resolve(cycle.fresh, goals.q_target)
            if self._infeasible is not None:
                return Fired(Trigger.INFEASIBLE, self._infeasible)
            too_far = goals.take(cycle.fresh, q, joints, cycle.now, stall)
            if too_far is not None:
                return Fired(too_far)
            stamp = None if q is None else cycle.fresh.stamp
        try:
            return self._sent(goals.goal(joints, cycle.now), stamp)
        except GuardError as error:
            return Fired(Trigger.GUARD_FAILED, str(error))

    def _give_way(self, cycle: Cycle) -> None:
        """Displaces the tool that follows by what a force asks for; of a soft one the robot sees to that."""
        if self._way is not None and not self._soft:
            said = self._way.why_not
            self._yielded = self._way.step(cycle.observation, cycle.now)
            if self._way.why_not is not None and said is None:
                self._report("warn", self._way.why_not)

    def _held_back(self) -> str | None:
        gives = self._way is not None and self._active.state is State.SERVO and not self._soft
        return super()._held_back() or (self._way.says if self._way is not None and gives else None)

    def _line(self, cycle: Cycle) -> Outcome:
        switched = self._switched(cycle)
        if switched is not None:
            return switched
        if cycle.switches.stop_count != self._active.stop_count:
            return Fired(Trigger.STOP_ASKED, cycle.switches.stop_because)
        if self._program.cancelled:
            return Fired(Trigger.CANCELLED)
        joints = cycle.observation.joints
        if self._active.data is None:
            lts = self._law is not None and self._law.lts and not self._soft
            stream = LineStream(self._settings.goals, self._limits, lts, joints, cycle.now, self._program.line)
            self._active = replace(self._active, data=stream)
        goals: LineStream = self._active.data
        lag = self._lag(goals, cycle)
        if lag is not None:
            return Fired(Trigger.LAG, lag)
        if goals.arrived and (self._soft or float(np.max(np.abs(joints - goals.q_goal))) <= SETTLED_RAD):
            return Fired(Trigger.ARRIVED)
        blocked = goals.blocked(cycle.now)
        if blocked is not None:
            return Fired(Trigger.NO_PROGRESS, blocked)
        try:
            return self._sent(goals.goal(joints, cycle.now))
        except GuardError as error:
            return Fired(Trigger.GUARD_FAILED, str(error))

    def _lag(self, goals: ServoStream, cycle: Cycle) -> str | None:
        """Returns what is wrong with an arm that does not follow; of a soft one the robot says when it has stopped."""
        return None if self._soft else goals.lag(cycle.observation.joints, cycle.now)

    def _sent(self, goal: LimitedGoal, stamp: float | None = None) -> Servo:
        if goal.limited_by is not None:
            self.counts["limited_goals"] += 1
            self.counts["goal_gaps"] += goal.limited_by == Limit.LATE_GOAL
            self._limited_by = (goal.limited_by,)
        self.counts["goals_sent"] += 1
        return Servo(goal.q, stamp, self.goal)

    def _braking(self, cycle: Cycle) -> Outcome:
        goals: ServoStream | None = self._active.data
        if goals is not None and self._active.state is State.LINE_BRAKING:
            lag = self._lag(goals, cycle)
            if lag is not None:
                return Fired(Trigger.LAG, lag)
        goal = None if goals is None else goals.brake(cycle.observation.joints, cycle.now)
        if goal is None:
            return Fired(self._active.at_rest)
        self.counts["goals_sent"] += 1
        return Servo(goal.q, reached=self.goal)


@dataclass(frozen=True)
class PtpSettings(LoopSettings):
    """Settings of the PTP loop besides; `joints_thresh`: smaller joint steps are not executed [rad]."""

    joints_thresh: float


class PtpLoop(ControlLoop[PtpSettings]):
    """Every desired tool frame that is far enough away is one PTP motion."""

    STATES = PTP_STATES
    PICK_UP = "the desired pose"
    NOT_COUNTED = frozenset({"pickups"})  # each motion goes to a desired pose

    def _follow(self, distance: float) -> Outcome:
        return Wait() if distance <= self._settings.joints_thresh else Fired(Trigger.FAR_TARGET)
