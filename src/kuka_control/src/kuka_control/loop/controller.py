"""One cycle of a controller: read the arm, step the control loop, execute its command. And the wait for a lost arm."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from kst import ConnectionLost, KstError, MotionRefused, ReplyTimeout
from kuka_control.loop.arm import NO_READING, Arm
from kuka_control.loop.commands import (
    End,
    Event,
    Inputs,
    Observation,
    Servo,
    StartPtp,
    StartServo,
    Step,
    StopServo,
    Wait,
)
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import Mode

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 5.0  # the pause between attempts doubles up to this [s]
REMIND_S = 30.0  # period of the warnings that the robot is still out of reach [s]

BACK = (
    "The robot is connected again. The arm stays where it is until control is switched on; then it goes home first "
    "and follows the desired tool frame."
)
MAX_MISSED = 5  # this many missing or unusable answers in a row end the link
WARN_EVERY_S = 1.0  # shortest time between two warnings about missed answers [s]


class ReconnectSupervisor:
    """Stands in for the control loop after a lost link to the robot: waits for the robot, then for the operator.

    While the link is down it says when the next attempt to connect is due, with growing pauses. Once the link is back
    the arm stays where it is. When control is switched on, or an exit is requested, a fresh control loop takes over and
    starts with the motion home.

    Attributes:
        counts: the counters of the previous control loop, which continue.
        reason: the published reason.
        next_try: time of the next attempt to connect, monotonic [s].
    """

    def __init__(self, error: KstError, counts: Counter[str], make_loop: Callable[[], ControlLoop], now: float) -> None:
        silent = isinstance(error, (ConnectionLost, ReplyTimeout))
        what = "The robot is out of reach" if silent else "The link to the robot was given up"
        self.counts = counts
        self._lost = (
            f"{what}: {error}. Control is off, and this controller tries to connect again. A server that lost its "
            "client may be deaf: then end MatlabToolboxServer on the smartPad and start it again."
        )
        self.reason = self._lost
        self.next_try = now + FIRST_PAUSE_S
        self._pause = FIRST_PAUSE_S
        self._tries = 0
        self._remind_at = now
        self._make_loop = make_loop
        self._loop: ControlLoop | None = None
        self._old_frame: DesiredFrame | None = None

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
        self._remind_at = now + REMIND_S
        return (Event("warn", f"The robot is still gone. {failure}"),)

    def connected(self) -> tuple[Event, ...]:
        """Records that the link is back; returns what to log."""
        self.reason = BACK
        return (Event("info", BACK),)

    def waiting(self) -> Step:
        """Returns the step while nothing moves."""
        return Step(Wait(), Mode.STOPPED, self.reason, ())

    def step(self, observation: Observation, now: float) -> Step:
        """Returns the step of the fresh control loop; before it exists, `waiting()`."""
        inputs = observation.inputs
        if self._loop is None:
            self._old_frame = inputs.desired
            if not (inputs.switches.control_on or inputs.switches.exit_requested):
                return self.waiting()
            self._loop = self._make_loop()
            self._loop.counts = self.counts
        if inputs.desired is self._old_frame:
            observation = replace(observation, inputs=replace(inputs, desired=None))
        return self._loop.step(observation, now)


class Controller:
    """Runs a control loop on an arm.

    Attributes:
        missed: number of answers of the robot's controller that were late or unusable.
        moving, in_servo: whether a PTP motion runs, and whether the arm follows servo goals.
    """

    def __init__(self, arm: Arm, loop: ControlLoop | ReconnectSupervisor) -> None:
        self.missed = 0
        self._warned_at = -math.inf
        self.restart(arm, loop)

    def restart(self, arm: Arm, loop: ControlLoop | ReconnectSupervisor) -> None:
        """Continues with another arm and loop; `missed` stays."""
        self._arm = arm
        self._loop = loop
        self.moving = False
        self.in_servo = False
        self._refused: str | None = None
        self._missed_in_a_row = 0

    def cycle(self, inputs: Inputs, now: float) -> Step:
        """Returns the step of one cycle at the monotonic time `now` [s]; KstError: the connection is given up."""
        self._watch_motion()
        refused, self._refused = self._refused, None
        observation = Observation(self._arm.measured_joints, inputs, not self.moving, refused)
        step = self._loop.step(observation, now)
        try:
            self._do(step)
            self._missed_in_a_row = 0
        except MotionRefused as error:
            self.moving = self.in_servo = False
            self._refused = str(error)
        except NO_READING as error:
            self._miss(step, error)
            step = replace(step, events=step.events + self._warning(error, now))
        remarks = tuple(Event("warn", remark) for remark in self._arm.take_remarks())
        return replace(step, events=step.events + remarks) if remarks else step

    def _miss(self, step: Step, error: KstError) -> None:
        """Counts a missing or unusable answer; raises its error again if the link is given up."""
        self.missed += 1
        if isinstance(step.command, (StartPtp, StartServo)):
            self.moving = False
            self._refused = str(error)
            return
        self._missed_in_a_row += 1
        if isinstance(step.command, StopServo) or self._missed_in_a_row >= MAX_MISSED:
            raise error

    def _warning(self, error: KstError, now: float) -> tuple[Event, ...]:
        if now - self._warned_at < WARN_EVERY_S:
            return ()
        self._warned_at = now
        what = "No answer in time" if isinstance(error, ReplyTimeout) else "An answer is left out"
        return (Event("warn", f"{what}: {error}."),)

    def _watch_motion(self) -> None:
        if self.moving:
            try:
                self.moving = not self._arm.ptp_arrived()
            except (MotionRefused, *NO_READING) as error:
                self.moving = False
                self._refused = str(error)

    def _do(self, step: Step) -> None:
        command = step.command
        if isinstance(command, Servo):
            self._arm.servo(command.q)
        elif isinstance(command, StartPtp):
            self._arm.start_ptp(command.q, command.velocity)
            self.moving = True
        elif isinstance(command, StartServo):
            self._arm.start_servo()
            self.in_servo = True
        elif isinstance(command, StopServo):
            self._arm.stop_servo()
            self.in_servo = False
        elif not isinstance(command, End):
            self._arm.read()
