"""What goes into a cycle of a control loop and what comes out of it. Joints q: shape (7,) [rad]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

import numpy as np

from kuka_control.loop.stream import Desired
from kuka_control.loop.transitions import Mode, State, Trigger
from kuka_control.model.target import Target


@dataclass(frozen=True)
class Observation:
    """The inputs of a cycle.

    Attributes:
        joints: measured joints, shape (7,) [rad].
        desired: the newest desired tool frame, or None.
        clock: ROS time [s], the clock of the stamps.
        control_on: whether the arm is to follow the desired tool frame.
        enable_count: how often control was switched on so far, so that off and on again is never overlooked.
        scale: scaling factor.
        exit_requested: whether the controller is to go to zero and exit.
        arrived: whether no PTP motion runs.
        refused: why the robot's controller refused the last command, or None.
    """

    joints: np.ndarray
    desired: Desired | None = None
    clock: float = 0.0
    control_on: bool = False
    enable_count: int = 0
    scale: float = 1.0
    exit_requested: bool = False
    arrived: bool = True
    refused: str | None = None


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
    """The result of a cycle.

    Attributes:
        command: for the arm.
        mode: the published mode.
        reason: why this mode, in sentences.
        events: what is to be logged.
        target: what the arm goes to or follows, or None.
        limited_by: what limited the last command: names of workspace bounds and of motion limits.
        transitions: what was taken of the table in this cycle.
    """

    command: Command
    mode: Mode
    reason: str
    events: tuple[Event, ...]
    target: Target | None = None
    limited_by: tuple[str, ...] = ()
    transitions: tuple[tuple[State, Trigger], ...] = ()
