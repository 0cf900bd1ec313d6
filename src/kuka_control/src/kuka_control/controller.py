"""One cycle of a controller: look at the arm, ask the control loop, do what it says."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kst.errors import MotionRefused, ReplyTimeout
from kuka_control.arm import Arm
from kuka_control.commands import End, Event, Observation, Servo, StartPtp, StartServo, Step, StopServo
from kuka_control.control_loop import ControlLoop
from kuka_control.stream import Desired

MAX_MISSED = 5
"""So many answers in a row may fail to come before the controller gives up."""


@dataclass(frozen=True)
class Inputs:
    """What comes from outside in a cycle; the attributes are those of `Observation`."""

    desired: Desired | None = None
    clock: float = 0.0
    control_on: bool = False
    engagements: int = 0
    scale: float = 1.0
    exit_requested: bool = False


class Controller:
    """Runs a control loop on an arm.

    Attributes:
        missed: answers of the robot's controller that did not come in time.
        moving: whether a PTP motion runs.
        in_servo: whether the arm follows servo goals.
    """

    def __init__(self, arm: Arm, loop: ControlLoop) -> None:
        self.missed = 0
        self._arm = arm
        self._loop = loop
        self.moving = False
        self.in_servo = False
        self._refused: str | None = None
        self._missed_in_a_row = 0

    def cycle(self, inputs: Inputs, now: float) -> Step:
        """Returns the step that was taken.

        Args:
            inputs: what came from outside.
            now: monotonic time [s].

        Raises:
            DeviceError: the connection is lost, or the robot's controller stays silent.
        """
        self._watch_motion()
        refused, self._refused = self._refused, None
        observation = Observation(
            joints=self._arm.measured_joints,
            desired=inputs.desired,
            clock=inputs.clock,
            control_on=inputs.control_on,
            engagements=inputs.engagements,
            scale=inputs.scale,
            exit_requested=inputs.exit_requested,
            arrived=not self.moving,
            refused=refused,
        )
        step = self._loop.step(observation, now)
        try:
            self._do(step)
            self._missed_in_a_row = 0
        except MotionRefused as error:
            self.moving = self.in_servo = False
            self._refused = str(error)
        except ReplyTimeout as error:
            if isinstance(step.command, (StartPtp, StartServo)):
                self.moving = False
                self._refused = str(error)
            elif isinstance(step.command, StopServo):
                raise
            else:
                self._missed_in_a_row += 1
                if self._missed_in_a_row >= MAX_MISSED:
                    raise
            self.missed += 1
            return replace(step, events=(*step.events, Event("warn", f"No answer in time: {error}.")))
        return step

    def _watch_motion(self) -> None:
        if self.moving:
            try:
                self.moving = not self._arm.ptp_arrived()
            except MotionRefused as error:
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
