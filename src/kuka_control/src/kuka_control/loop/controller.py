"""One cycle of a controller: read the arm, step the control loop, execute its command. And the wait for a lost arm:
from the first missing answer nothing is sent and the goals hold; after `NAMED_S` the link is reported lost; after
`OFF_S` control is switched off. A new connection is tried only once the client has given up the old one."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from common.modes import Mode
from kst import (
    ConnectionLost,
    KstError,
    MotionInterrupted,
    MotionRefused,
    MotionStopped,
    ReplyTimeout,
    WordRefused,
    WrongMode,
)
from kuka_control.loop.arm import NO_READING, WAIT_S, Arm
from kuka_control.loop.commands import (
    ASKED,
    End,
    Event,
    Inputs,
    Observation,
    PausePtp,
    Servo,
    StartGuiding,
    StartPtp,
    StartServo,
    Step,
    StopPtp,
    StopServo,
    Wait,
)
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.ptp_contact import touched
from kuka_control.model.robot_shape import Opening
from kuka_control.model.switches import ExitInPlace
from kuka_control.numbers import FIRST_PAUSE_S, LONGEST_PAUSE_S, MAX_MISSED, MISSING_S, NAMED_S, OFF_S

BACK = (
    "The robot is connected again. The arm stays where it is until control is switched on; then it goes home first "
    "and follows the desired tool frame."
)
WAITING = "Control is off, nothing is sent, and the same connection is probed for up to 10 s."
DEAF = "A server that lost its client may be deaf: then end MatlabToolboxServer on the smartPad and start it again."
_SILENT = "this controller was silent for longer than watchdog_brake"
WHY = {"the client": ASKED, "the watchdog": _SILENT, "the client was silent": _SILENT}
"""What the robot names as the reason of a stop, in other words where its own say too little."""
WARN_EVERY_S = 1.0  # shortest time between two warnings about missed answers [s]


def _why(error: MotionStopped) -> str:
    reason = error.reason.rpartition(": ")[2]
    return WHY.get(reason, reason)


class ReconnectSupervisor:
    """Stands in for the control loop after a lost link to the robot: waits for the robot, then for the operator. The
    arm stays where it is until control is switched on or an exit is requested; then a fresh control loop begins with
    the motion home.

    Attributes:
        counts: the counters of the previous control loop, which continue.
        next_try: time of the next attempt to connect, monotonic [s]; the pauses grow."""

    def __init__(
        self, error: KstError, counts: Counter[str], make_loop: Callable[[], ControlLoop], deaf: bool = True
    ) -> None:
        """`deaf`: a server that lost its client may be, as that of the toolbox."""
        self.counts = counts
        self._cure = f" {DEAF}" if deaf else ""
        self._lost = ""
        self.reason = f"The robot does not answer: {error}. {WAITING}"
        self.next_try = math.inf
        self._pause = FIRST_PAUSE_S
        self._tries = 0
        self._remind_at = 0.0
        self._make_loop = make_loop
        self._loop: ControlLoop | None = None
        self._old_frame: DesiredFrame | None = None
        self._opening: Opening | None = None

    def lost(self, error: KstError, now: float) -> tuple[Event, ...]:
        """Records that the connection is lost at the time `now` [s]; returns what to log."""
        silent = isinstance(error, (ConnectionLost, ReplyTimeout))
        what = "The robot is out of reach" if silent else "The link to the robot was given up"
        self.reason = self._lost = (
            f"{what}: {error}. Control is off, and this controller tries to connect again.{self._cure}"
        )
        self.next_try, self._remind_at = now + FIRST_PAUSE_S, now
        return (Event("error", self._lost),)

    def open_hand(self, opening: Opening | None) -> None:
        """As `ControlLoop.open_hand`; the fresh loop begins with what is known then."""
        self._opening = opening
        if self._loop is not None:
            self._loop.open_hand(opening)

    @property
    def guard_scale(self) -> float:
        """As `ControlLoop.guard_scale`."""
        return 1.0 if self._loop is None else self._loop.guard_scale

    @property
    def when_enabled(self) -> str | None:
        """As `ControlLoop.when_enabled`."""
        return None if self._loop is None else self._loop.when_enabled

    @property
    def exit_in_place(self) -> ExitInPlace | None:
        """As `ControlLoop.exit_in_place`."""
        return None if self._loop is None else self._loop.exit_in_place

    @property
    def stopped_because(self) -> str | None:
        """Why the arm cannot move, a sentence; None if nothing inhibits it."""
        return self.reason if self._loop is None else self._loop.stopped_because

    def failed(self, error: KstError, now: float) -> tuple[Event, ...]:
        """Records an attempt that failed at the time `now` [s]; returns what to log."""
        self._tries += 1
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE_S)
        self.next_try = now + self._pause
        failure = f"Try {self._tries} failed: {error}."
        self.reason = f"{self._lost} {failure}"
        if now < self._remind_at:
            return ()
        period = 30.0  # of the warnings that the robot is still out of reach [s]
        self._remind_at = now + period
        return (Event("warn", f"The robot is still gone. {failure}"),)

    def connected(self) -> tuple[Event, ...]:
        """Records that the link is back; returns what to log."""
        self.reason = BACK
        return (Event("info", BACK),)

    def waiting(self) -> Step:
        return Step(Wait(), Mode.STOPPED, self.reason, ())

    def step(self, observation: Observation, now: float) -> Step:
        """Returns the step of the fresh control loop; before it exists, `waiting()`."""
        inputs = observation.inputs
        if self._loop is None:
            self._old_frame = inputs.desired
            if not (inputs.switches.control_on or inputs.switches.exit_requested) or not observation.arrived:
                return self.waiting()
            self._loop = self._make_loop()
            self._loop.counts = self.counts
            self._loop.open_hand(self._opening)
        if inputs.desired is self._old_frame:
            observation = replace(observation, inputs=replace(inputs, desired=None))
        return self._loop.step(observation, now)


class Controller:
    """Runs a control loop on an arm.

    Attributes:
        missed: number of answers of the robot's controller that were late or unusable.
        holds: number of times that a missing answer held the goals."""

    def __init__(self, arm: Arm, loop: ControlLoop | ReconnectSupervisor) -> None:
        self.missed = self.holds = 0
        self.moving = self.in_servo = False
        self._warned_at = -math.inf
        self._arm = arm
        self.restart(arm, loop)

    def restart(self, arm: Arm, loop: ControlLoop | ReconnectSupervisor) -> None:
        """Continues with another loop, and perhaps another arm; the counters stay."""
        if arm is not self._arm:
            self.moving = self.in_servo = False
        self._arm = arm
        self._loop = loop
        self._refused: str | None = None
        self._stopped: str | None = None
        self._contact: str | None = None
        self._torques: np.ndarray | None = None  # the ranges within which the last PTP motion continues
        self._missed_in_a_row = 0
        self._missing_since = 0.0  # when the first of them was missed [s]
        self._silent = 0.0  # how long the present hold has lasted [s]
        self._joints = arm.measured_joints  # the newest
        self._read_from = self._cycle_from = -math.inf  # they were measured after this; when the last cycle began [s]
        self._force: np.ndarray | None = None  # the newest, and the begin of the cycle in which it was read [s]
        self._force_from = -math.inf
        self._step: Step | None = None

    def cycle(self, inputs: Inputs, now: float) -> Step:
        """Returns the step of one cycle at the monotonic time `now` [s]. Raises ReplyTimeout: the robot has not
        answered for so long that control is to go off; it may answer later; KstError: the connection is given up."""
        events: tuple[Event, ...] = ()
        before, self._cycle_from = self._cycle_from, now
        silent = self._arm.silence()
        if silent > 0.0:
            return self._hold(silent)
        if self._silent > 0.0 and self._step is not None:
            # The wait for the answer took time that `now` does not know: the goals continue in the next cycle.
            if self._silent > NAMED_S:
                events = (Event("info", f"The robot answers again after {self._silent:.2f} s."),)
            self._silent = 0.0
            return replace(self._step, command=Wait(), events=events, transitions=())
        events += self._watch_motion(now)
        refused, self._refused = self._refused, None
        contact, self._contact = self._contact, None
        stopped, self._stopped = self._stopped, None
        joints, age = self._arm.measured_joints, math.inf
        if joints is not self._joints:  # a goal that left, or an answer without joints, is no reading
            self._joints, self._missed_in_a_row = joints, 0
            # They were measured after their question was sent, and before their answer was read.
            delay = self._arm.round_trip or 0.0
            age, self._read_from = now + min(delay, WAIT_S) - self._read_from, before - delay
        stops = "stop" in self._arm.abilities
        if self._arm.state.force is not self._force:
            self._force, self._force_from = self._arm.state.force, before - (self._arm.round_trip or 0.0)
        observation = Observation(
            *(joints, inputs, not self.moving, refused, stopped, stops, self._arm.state.paused, contact, age),
            *(self._force, now - self._force_from, self._arm.reckoned),
        )
        step = self._loop.step(observation, now)
        try:
            if not (self.moving or self.in_servo):
                self._arm.carry(inputs.switches.payload)
            self._do(step)
        except MotionStopped as error:
            self._stopped = _why(error)
            if self.in_servo:
                self._arm.stop_servo()
            self.moving = self.in_servo = False
        except MotionRefused as error:
            self.moving = self.in_servo = False
            self._refused = str(error)
        except NO_READING as error:
            self._miss(step, error, now)
            events += self._warning(error, now)
        events += tuple(Event("warn", remark) for remark in self._arm.take_remarks())
        self._step = step = replace(step, events=step.events + events) if events else step
        return step

    def regained(self) -> bool:
        """Returns whether a robot that was silent answers again, with servo mode left; KstError: it is given up."""
        try:
            if self._arm.silence() > 0.0:
                return False
            if self.in_servo:
                self._arm.stop_servo()
        except (MotionRefused, WrongMode):
            self.moving = False
        except NO_READING:
            return False
        self.in_servo = False
        return True

    def _hold(self, silent: float) -> Step:
        """Returns the step of a cycle in which nothing is sent, because an answer has been missing for so long [s]."""
        before, self._silent = self._silent, silent
        self.holds += before == 0.0
        if silent > (OFF_S if self.in_servo else 2.0 * OFF_S):
            raise ReplyTimeout(f"the last answer has been missing for {silent:.1f} s")
        what = "the goals hold" if self.in_servo else "nothing is sent"
        if self._step is None:
            self._step = Step(Wait(), Mode.STOPPED, "", ())
        reason = f"The robot has not answered for {1000.0 * silent:.0f} ms; {what}."
        named = before <= NAMED_S < silent
        self.missed += named and self._missed_in_a_row == 0
        events = (Event("warn", f"The link to the robot is lost for the moment. {reason}"),) if named else ()
        return replace(self._step, command=Wait(), reason=reason, events=events, transitions=())

    def _miss(self, step: Step, error: KstError, now: float) -> None:
        """Counts a missing or unusable answer; raises its error again if the link is given up."""
        self.missed += 1
        if isinstance(step.command, (StartPtp, StartServo, StartGuiding)):
            if error.pending:
                self.in_servo = isinstance(step.command, StartServo)
                raise error
            self._refused = str(error)
            return
        if self._missed_in_a_row == 0:
            self._missing_since = now
        self._missed_in_a_row += 1
        many = self._missed_in_a_row >= MAX_MISSED and now - self._missing_since >= MISSING_S
        if isinstance(step.command, StopServo) or many:
            raise error

    def _warning(self, error: KstError, now: float) -> tuple[Event, ...]:
        if now - self._warned_at < WARN_EVERY_S:
            return ()
        self._warned_at = now
        what = "No answer in time" if isinstance(error, ReplyTimeout) else "An answer is left out"
        return (Event("warn", f"{what}: {error}."),)

    def _watch_motion(self, now: float) -> tuple[Event, ...]:
        if self.moving:
            try:
                self.moving = not self._arm.ptp_arrived()
            except MotionRefused as error:
                self.moving = False
                self._refused = str(error)
            except MotionStopped as error:
                self.moving = False
                self._stopped = _why(error)
            except MotionInterrupted as error:
                self.moving = False
                self._contact = touched(error.torques, self._torques)
            except NO_READING as error:
                self.missed += 1
                return self._warning(error, now)
        return ()

    def _do(self, step: Step) -> None:
        command = step.command
        if isinstance(command, Servo):
            self._arm.servo(command.q)
        elif isinstance(command, StartPtp):
            self._torques = command.torques
            self._arm.start_ptp(command.q, command.velocity, command.torques)
            self.moving = True
        elif isinstance(command, StartServo):
            if "soft" in self._arm.abilities:
                try:
                    self._arm.soften(command.soft)
                except WordRefused as error:
                    raise MotionRefused(str(error)) from error
            self._arm.start_servo()
            self.in_servo = True
        elif isinstance(command, StartGuiding):
            try:
                self._arm.start_guiding()
            except WordRefused as error:
                raise MotionRefused(str(error)) from error
            self.moving = True
        elif isinstance(command, StopServo):
            self._arm.stop_servo()
            self.in_servo = False
        elif isinstance(command, StopPtp):
            self._arm.stop()
        elif isinstance(command, PausePtp):
            with contextlib.suppress(WordRefused):  # it has just ended, or brakes; the next cycle looks again
                self._arm.pause(command.on)
            self._arm.read()
        elif not isinstance(command, End):
            self._arm.read()
