"""What goes into a cycle of a control loop and what comes out of it. Joints q: shape (7,) [rad]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np

from kuka_control.loop.switches import SwitchState
from kuka_control.loop.transitions import State, Trigger
from kuka_control.model.desired_frame import DesiredFrame
from kuka_control.model.mode import Mode
from kuka_control.model.target import Target


@dataclass(frozen=True)
class Inputs:
    """What comes from outside in a cycle."""

    desired: DesiredFrame | None = None
    """The newest desired tool frame."""
    clock: float = 0.0
    """ROS time [s], the clock of the stamps."""
    switches: SwitchState = SwitchState()
    """What the operator switched."""


@dataclass(frozen=True)
class Observation:
    """What a control loop decides on in a cycle."""

    joints: np.ndarray
    """Measured joints."""
    inputs: Inputs = Inputs()
    """What comes from outside."""
    arrived: bool = True
    """Whether no PTP motion runs."""
    refused: str | None = None
    """Why the robot's controller refused the last command."""


@dataclass(frozen=True)
class Wait:
    """Nothing to do."""


@dataclass(frozen=True)
class StartPtp:
    """Move to `q` at the fraction `velocity` of the full joint speed."""

    q: np.ndarray
    velocity: float


@dataclass(frozen=True)
class StartServo:
    """Start to follow servo goals."""


@dataclass(frozen=True)
class Servo:
    """Send the servo goal `q`; `stamp` is that of the desired tool frame that came in with it, or None."""

    q: np.ndarray
    stamp: float | None = None


@dataclass(frozen=True)
class StopServo:
    """Leave servo mode."""


@dataclass(frozen=True)
class End:
    """The controller exits; `fault` says why, None if it was asked to."""

    fault: str | None = None


Command = Union[Wait, StartPtp, StartServo, Servo, StopServo, End]


@dataclass(frozen=True)
class Event:
    """One sentence for the log; `level` is "info", "warn" or "error"."""

    level: str
    sentence: str


@dataclass(frozen=True)
class Step:
    """The result of a cycle."""

    command: Command
    """For the arm."""
    mode: Mode
    """The published mode."""
    reason: str
    """Why this mode, in sentences."""
    events: tuple[Event, ...]
    """What to log."""
    target: Target | None = None
    """Where the arm goes, or what it follows."""
    limited_by: tuple[str, ...] = ()
    """The workspace bounds and the motion limits that acted on the last command."""
    transitions: tuple[tuple[State, Trigger], ...] = ()
    """The transitions taken in this cycle."""
