"""What goes into a cycle of a control loop and what comes out of it. Joints q: shape (7,) [rad]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Union

import numpy as np

from common.limits import Limit
from common.modes import Mode
from kuka_control.loop.moves import MoveProgress, ProgramMotion
from kuka_control.loop.transitions import Action, State, Trigger
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.switches import SwitchState
from kuka_control.model.target import MotionScaling, Target

ASKED = "it was asked to"  # why the robot has stopped the arm


@dataclass(frozen=True)
class Inputs:
    desired: DesiredFrame | None = None  # the newest desired tool frame
    clock: float = 0.0  # ROS time [s], the clock of the stamps
    switches: SwitchState = SwitchState()  # what the operator switched
    move: ProgramMotion | None = None  # the motion that a program asked for last, if it has not ended
    missing: str | None = None  # that no desired tool frame comes, and what comes instead, a sentence


@dataclass(frozen=True)
class Observation:
    joints: np.ndarray  # measured joints
    inputs: Inputs = Inputs()  # what comes from outside
    arrived: bool = True  # whether no PTP motion runs
    refused: str | None = None  # why the robot's controller refused the last command
    stopped: str | None = None  # why the robot has stopped the arm
    stops: bool = False  # whether the robot can stop a PTP motion
    paused: bool = False  # whether the robot has paused the PTP motion
    contact: str | None = None  # what the arm felt that ended the last PTP motion before its goal
    age: float = math.inf  # so much older at most were the joints that were measured before [s]
    force: np.ndarray | None = None  # the newest force at the tool point, in its axes, shape (3,) [N]
    force_age: float = math.inf  # so old it is at most [s]
    reckoned: tuple[bool, float] = (False, 0.0)  # of the weight, as Arm.reckoned


@dataclass(frozen=True)
class Wait:
    """Nothing to do."""


@dataclass(frozen=True)
class StartPtp:
    """Move to `q` at the fraction `velocity` of the full joint speed. `torques`: the motion ends where an external
    joint torque leaves its range, shape (7, 2) [Nm]; None: never."""

    q: np.ndarray
    velocity: float
    torques: np.ndarray | None = None


@dataclass(frozen=True)
class StartServo:
    """Start to follow servo goals; `soft`: the arm yields to forces then."""

    soft: bool = False


@dataclass(frozen=True)
class Servo:
    """Send the servo goal `q`."""

    q: np.ndarray
    stamp: float | None = None  # of the desired tool frame that came in with it
    reached: np.ndarray | None = None  # joints to which goals made for the servo law bring the arm; None: q


@dataclass(frozen=True)
class StopServo:
    """Leave servo mode."""


@dataclass(frozen=True)
class StartGuiding:
    """Let a hand move the arm."""


@dataclass(frozen=True)
class StopPtp:
    """Stop the PTP motion that runs."""


@dataclass(frozen=True)
class PausePtp:
    """Pause the PTP motion that runs, or continue it."""

    on: bool


@dataclass(frozen=True)
class End:
    """The controller exits; `fault` says why, None if it was asked to."""

    fault: str | None = None


Command = Union[Wait, StartPtp, StartServo, Servo, StopServo, StartGuiding, StopPtp, PausePtp, End]

COMMANDS: dict[Action, Command] = {
    Action.NONE: Wait(),
    Action.START_SERVO: StartServo(),
    Action.STOP_SERVO: StopServo(),
    Action.GUIDE: StartGuiding(),
}
"""The commands of the actions that need no data."""


@dataclass(frozen=True)
class Event:
    """One sentence for the log; `level` is "info", "warn" or "error"."""

    level: str
    sentence: str


@dataclass(frozen=True)
class Step:
    command: Command  # for the arm
    mode: Mode  # the published mode
    reason: str  # why this mode, in sentences, and why the arm does not follow the desired tool frame that comes
    events: tuple[Event, ...]  # what to log
    target: Target | None = None  # where the arm goes, or what it follows
    limited_by: tuple[Limit, ...] = ()  # the workspace bounds and the motion limits that acted on the last command
    transitions: tuple[tuple[State, Trigger], ...] = ()  # the transitions taken in this cycle
    move: MoveProgress | None = None  # of the last motion for a program
    scaling: MotionScaling | None = None  # of the desired tool frame; None while nothing follows it
    inhibited: bool = False  # whether desired tool frames come or are awaited that cannot be followed
