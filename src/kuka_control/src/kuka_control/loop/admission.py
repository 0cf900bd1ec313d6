"""Whether the arm may go to the desired tool frame: the states of the stream that comes, and what keeps the arm from it
otherwise. The control loop, the published reason and the answer of the switch ask the same object.
docs/reference/control-loop.md is made from both tables. Times `now` are monotonic [s].

A hand is followed only if its stream begins while control is on, so that the conditions under which a stream starts
hold when the arm starts. A stream that no hand brings is taken over if it is near."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from kuka_control.loop.commands import Inputs
from kuka_control.loop.goal_stream import rare_frames
from kuka_control.loop.own_motions import OwnMotions
from kuka_control.loop.transitions import State, Trait, Trigger
from kuka_control.model.desired_frame import HAND_IN_AGAIN, DesiredFrame, DesiredStream, StreamUpdate, until_anew
from kuka_control.numbers import ANNOUNCED_S, BLOCKED_S, FOREIGN_PAUSE_S, NEAR_M, NEAR_RAD

_MOVED_BEFORE = f"The desired tool frame moved before control was switched on and does not count: {HAND_IN_AGAIN}"
TAKEN_OVER = (
    f"The desired tool frame came before control was switched on; {ANNOUNCED_S:g} s after it is announced the arm "
    "goes there slowly and follows it."
)
SILENT = "No desired tool frame comes."
OFF = "Control is off, so the desired tool frame is not followed."


class Admission(Enum):
    """A state of the present stream of desired tool frames."""

    ADMITTED = "counts"
    RAN_BEFORE = "ran before control was switched on"
    ANNOUNCED = "ran before, and it is announced that the arm takes it over"
    REJECTED = "does not count"
    REJECTED_BEFORE = "ran before, and does not count for another reason"


class StreamEvent(Enum):
    """What happens to a stream."""

    BEGINS = "a stream begins"
    SWITCHED_ON = "control is switched on while it comes"
    PAUSES = "no frame comes"
    HAND = "a hand brings a frame"
    NEAR = "a node's frame is near the tool at home"
    FAR = "a node's frame is far from the tool at home"
    FOLLOWED = "the arm begins to go there"
    CONFLICT = "the frame has two publishers, or its chain or clock jumped"
    PROGRAM = "a program moves the arm"


@dataclass(frozen=True)
class AdmissionRow:
    sources: tuple[Admission, ...]
    event: StreamEvent
    target: Admission
    sentence: str = ""  # why the arm does not go there; {detail} is from the event, {anew}: when a stream counts again
    level: str = ""  # at which the sentence is logged, "": it is not


_A, _E = Admission, StreamEvent
_FRESH = (_A.ADMITTED, _A.REJECTED)
_BEFORE = (_A.RAN_BEFORE, _A.ANNOUNCED, _A.REJECTED_BEFORE)
_MOVED_MEANWHILE = "The desired tool frame began to move while a program moved the arm. {anew}"

ADMISSIONS = (
    AdmissionRow(tuple(_A), _E.BEGINS, _A.ADMITTED),
    AdmissionRow(tuple(_A), _E.SWITCHED_ON, _A.RAN_BEFORE),
    AdmissionRow(_BEFORE, _E.HAND, _A.REJECTED, _MOVED_BEFORE),
    AdmissionRow((_A.RAN_BEFORE, _A.ANNOUNCED), _E.FAR, _A.REJECTED, "{detail}", "warn"),
    AdmissionRow((_A.RAN_BEFORE,), _E.NEAR, _A.ANNOUNCED, TAKEN_OVER, "info"),
    AdmissionRow((_A.ANNOUNCED,), _E.PAUSES, _A.RAN_BEFORE),
    AdmissionRow((_A.RAN_BEFORE, _A.ANNOUNCED), _E.FOLLOWED, _A.ADMITTED),
    # A stream that was in conflict, or ran during a program's motion, waits for another one.
    AdmissionRow(_FRESH, _E.CONFLICT, _A.REJECTED, "{detail} {anew}"),
    AdmissionRow(_BEFORE, _E.CONFLICT, _A.REJECTED_BEFORE, "{detail} {anew}"),
    AdmissionRow(_FRESH, _E.PROGRAM, _A.REJECTED, _MOVED_MEANWHILE),
    AdmissionRow(_BEFORE, _E.PROGRAM, _A.REJECTED_BEFORE, _MOVED_MEANWHILE),
)
"""All transitions; a pair of state and event without a row changes nothing."""

_TABLE = {(source, row.event): row for row in ADMISSIONS for source in row.sources}


class Where(Enum):
    """In which states of the control loop a refusal counts."""

    ANYWHERE = "anywhere", frozenset(State)
    AT_REST = "at rest", frozenset(state for state in State if Trait.RESTS in state.traits)
    IN_SERVO_MODE = "in servo mode", frozenset({State.SERVO})

    def __init__(self, text: str, states: frozenset[State]) -> None:
        self.text = text
        self.states = states


class RefusalRow(NamedTuple):
    when: str  # in words
    where: Where
    sentence: Callable[[StreamAdmission, float], str | None]  # at the time `now`


REFUSALS: tuple[RefusalRow, ...] = (
    RefusalRow("its frames are refused", Where.ANYWHERE, lambda a, now: a.stream.refusal(now)),
    RefusalRow("it does not count", Where.ANYWHERE, lambda a, _: a.rejection if a.stream.runs else None),
    RefusalRow("it pauses", Where.IN_SERVO_MODE, lambda a, _: None if a.stream.runs else SILENT),
    RefusalRow("its frames come too rarely", Where.IN_SERVO_MODE, lambda a, _: a.rare),
    RefusalRow("its frames are farther apart than time_out", Where.AT_REST, lambda a, _: a.too_slow),
    RefusalRow("it is announced that the arm takes it over", Where.ANYWHERE, lambda a, _: a.announced),
    RefusalRow("a body is in the way to it", Where.ANYWHERE, lambda a, now: a.blocked.shown(now)),
    RefusalRow("a motion that nobody asked for waits", Where.ANYWHERE, lambda a, now: a.waits.shown(now)),
)
"""Why an arm whose control is on does not follow the stream; the first row that holds counts."""


class Postponed(NamedTuple):
    """That the arm does not begin to move until then, and why."""

    sentence: str = ""
    until: float = -math.inf

    def shown(self, now: float) -> str | None:
        tick = 0.1  # the longest time between two frames in which it is still shown [s]
        return self.sentence if now <= self.until + tick else None


class StreamAdmission:
    """Knows whether the stream of desired tool frames counts.

    Attributes:
        stream: the frames that come.
        state: of the stream.
        when_enabled: what happens to the present frame once control is switched on, a sentence; None if none comes.
        rare: that the frames in servo mode come too rarely, a sentence.
        blocked: that a body is in the way to the frame.
        waits: that the arm would repeat a motion.
        own: the motions that nobody asked for."""

    def __init__(
        self,
        time_out: float,
        least_rate: float,
        away: Callable[[np.ndarray], tuple[float, float]],
        report: Callable[[str, str], None],
    ) -> None:
        """Frames farther apart than `time_out` [s] or rarer than `least_rate` [Hz] are not followed. `away` returns
        how far a tool frame, shape (4, 4) [m], is from the tool at home: [m], [rad]; `report` logs a sentence."""
        self.stream: DesiredStream = DesiredStream()
        self.state = Admission.ADMITTED
        self.when_enabled: str | None = None
        self.rare: str | None = None
        self.blocked: Postponed = Postponed()
        self.waits: Postponed = Postponed()
        self.own = OwnMotions()
        self._time_out = time_out
        self._least_rate = least_rate
        self._away = away
        self._report = report
        self._sentence = ""  # of the state
        self._since = 0.0  # when it was entered
        self._enable_count = 0
        self._engagement: int | None = None  # of the hand that was accepted last

    def take(self, inputs: Inputs, now: float, in_servo: bool) -> StreamUpdate:
        """Takes what came since the cycle before; returns the verdict on the newest frame."""
        switches, before = inputs.switches, self.stream.number
        if switches.enable_count != self._enable_count:
            self._enable_count = switches.enable_count
            self.own.forget()
            if self.stream.lasts:
                self._happens(StreamEvent.SWITCHED_ON, now)
        update = self.stream.take(inputs.desired, inputs.clock, now, in_servo)
        fresh = update.fresh
        if update.refused:
            self._report("warn", update.refused)
        if self.stream.number != before:
            self._happens(StreamEvent.BEGINS, now)
        if not self.stream.runs:
            self._happens(StreamEvent.PAUSES, now)
        if update.conflict is not None:
            self._happens(StreamEvent.CONFLICT, now, update.conflict)
        elif fresh is not None and not fresh.foreign:
            self._happens(StreamEvent.HAND, now)
        if fresh is not None and fresh.engagement not in (None, self._engagement):
            self._engagement = fresh.engagement
            self.own.forget()
        self.when_enabled = self._once_enabled(fresh, now) if self.stream.runs and not switches.control_on else None
        return update

    def program_moves(self, now: float) -> None:
        """A program moves the arm in this cycle."""
        if self.stream.runs:
            self._happens(StreamEvent.PROGRAM, now)

    def followed(self, now: float) -> None:
        """The arm begins to go to the stream."""
        self.rare = None
        self._happens(StreamEvent.FOLLOWED, now)

    def hear_rate(self, rare: str | None) -> None:
        """Takes over whether the frames in servo mode come too rarely; says so once."""
        if rare is not None and self.rare is None:
            self._report("warn", rare)
        self.rare = rare

    def block(self, sentence: str, now: float) -> None:
        """The collision guard refuses the motion to the frame; the arm looks again a little later."""
        if now > self.blocked.until + BLOCKED_S:
            self._report("warn", sentence)
        self.blocked = Postponed(sentence, now + BLOCKED_S)

    def repeats(self, source: State, trigger: Trigger, fresh: DesiredFrame, now: float) -> bool:
        """Returns whether what `trigger` begins would repeat a motion that nobody asked for too soon."""
        waits = self.own.waits(source, trigger, fresh.foreign, now)
        if waits is not None and self.waits.shown(now) is None:
            self._report("info", waits)
        self.waits = Postponed() if waits is None else Postponed(waits, now)
        return waits is not None

    @property
    def admitted(self) -> bool:
        """Whether frames come that the arm may go to, now or later."""
        return self.stream.runs and self.rejection is None

    @property
    def decided(self) -> bool:
        """Whether a motion to the stream that was to begin still may. It may not once control was off meanwhile."""
        return self.state in (Admission.ADMITTED, Admission.ANNOUNCED)

    @property
    def ran_before(self) -> bool:
        """Whether the arm goes to a stream that counts slowly."""
        return self.state in (Admission.RAN_BEFORE, Admission.ANNOUNCED)

    def admits(self, fresh: DesiredFrame, now: float) -> bool:
        """Returns whether an arm at rest goes to a new frame of a stream that counts."""
        if now < self.blocked.until or not self.stream.steady(self._time_out):
            return False
        if self.ran_before:
            self._happens(*self._judged(fresh, now))
        announced = self.state is Admission.ANNOUNCED and now - self._since >= ANNOUNCED_S
        return announced or self.state is Admission.ADMITTED

    def refusal(self, control_on: bool, state: State, now: float) -> str | None:
        """Returns the first reason why incoming frames are not followed in a state of the loop, a sentence, or None."""
        if not control_on:
            return OFF if state in Where.AT_REST.states and self.stream.runs else None
        sentences = (row.sentence(self, now) for row in REFUSALS if state in row.where.states)
        return next(filter(None, sentences), None)

    @property
    def rejection(self) -> str | None:
        """Why the stream does not count, a sentence, or None."""
        return self._sentence if self.state in (Admission.REJECTED, Admission.REJECTED_BEFORE) else None

    @property
    def announced(self) -> str | None:
        """That the arm takes the stream over, a sentence, or None."""
        return self._sentence if self.state is Admission.ANNOUNCED else None

    @property
    def too_slow(self) -> str | None:
        """That the frames are farther apart than the time-out, a sentence, or None."""
        return self.stream.too_slow(self._time_out)

    def _happens(self, event: StreamEvent, now: float, detail: str = "") -> None:
        row = _TABLE.get((self.state, event))
        if row is None:
            return
        self.state = row.target
        self._since = now
        self._sentence = self._said(row, detail)
        if row.level:
            self._report(row.level, self._sentence)

    def _said(self, row: AdmissionRow, detail: str) -> str:
        return row.sentence.format(detail=detail, anew=until_anew(self.stream.foreign))

    def _judged(self, fresh: DesiredFrame, now: float) -> tuple[StreamEvent, float, str]:
        """Returns what a frame of a stream is that ran before control was switched on."""
        if not fresh.foreign:
            return StreamEvent.HAND, now, ""
        far = too_far(*self._away(fresh.T_base_tool))
        return (StreamEvent.NEAR, now, "") if far is None else (StreamEvent.FAR, now, far)

    def _once_enabled(self, fresh: DesiredFrame | None, now: float) -> str | None:
        if fresh is None:
            return self.stream.refusal(now) or self.when_enabled
        if fresh.foreign and self.too_slow is not None:
            return self.too_slow
        event, _, detail = self._judged(fresh, now)
        said = self._said(_TABLE[Admission.RAN_BEFORE, event], detail)
        rate = self.stream.rate
        if event is StreamEvent.NEAR and rate is not None and rate < self._least_rate:
            return f"{said} {rare_frames(rate)}"
        return said


def too_far(distance: float, turn: float) -> str | None:
    """Returns why the arm does not take a stream over that is so far from the tool at home [m], [rad], or None."""
    if distance <= NEAR_M and turn <= NEAR_RAD:
        return None
    return (
        f"The desired tool frame came before control was switched on and is {1e3 * distance:.0f} mm and "
        f"{math.degrees(turn):.0f} deg from the tool at home, but the arm takes it over only within "
        f"{1e3 * NEAR_M:.0f} mm and {math.degrees(NEAR_RAD):.0f} deg: bring it nearer and switch control off and on, "
        f"or let it pause for {FOREIGN_PAUSE_S:g} s."
    )
