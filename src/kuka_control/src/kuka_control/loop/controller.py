"""One cycle of a controller: read the arm, step the control loop, execute its command."""

from __future__ import annotations

import math
from dataclasses import replace

from kst import KstError, MotionRefused, ReplyTimeout
from kuka_control.loop.arm import NO_READING, Arm
from kuka_control.loop.commands import End, Event, Inputs, Observation, Servo, StartPtp, StartServo, Step, StopServo
from kuka_control.loop.control_loop import ControlLoop
from kuka_control.loop.reconnect import ReconnectSupervisor

MAX_MISSED = 5
"""This many missing or unusable answers in a row end the link."""

WARN_EVERY_S = 1.0
"""Shortest time between two warnings about missed answers [s]."""


class Controller:
    """Runs a control loop on an arm.

    Attributes:
        missed: number of answers of the robot's controller that were late or unusable.
        moving: whether a PTP motion runs.
        in_servo: whether the arm follows servo goals.
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
        """Returns the step of one cycle at the monotonic time `now` [s].

        Raises:
            KstError: the connection is lost, or too many answers in a row were missing or unusable.
        """
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
        if isinstance(error, ReplyTimeout):
            return (Event("warn", f"No answer in time: {error}."),)
        return (Event("warn", f"An answer is left out: {error}."),)

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
