"""What the control panel shows, and which of its controls are enabled."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from common.modes import Mode
from common.operator_rows import OLD_ROWS_S
from kuka_control.numbers import SCALING_DEFAULT

ABSENT_S = OLD_ROWS_S  # without a status for this long the controller counts as absent [s]


class Tone(Enum):
    """How important a sentence of the control panel is."""

    NORMAL = "normal"
    WARNING = "warning"
    FAULT = "fault"


@dataclass(frozen=True)
class ControllerStatus:
    """The controller's last published state; `received` is a time of this machine's monotonic clock [s]."""

    received: float
    control_on: bool
    gripper_on: bool
    scaling_factor: float
    mode: str
    reason: str
    limited_by: tuple[str, ...] = ()
    host: str = ""
    pid: int = 0
    abilities: tuple[str, ...] = ()  # of the application on the robot's controller
    paused: bool = False
    guided: bool = False

    @property
    def stops(self) -> bool:
        """Whether the robot can stop and pause a motion to a point."""
        return "stop" in self.abilities


@dataclass(frozen=True)
class PanelContext:
    master: str = ""  # address of the ROS master
    master_lost: bool = False  # it does not answer
    runs: bool | None = None  # whether the controller's process runs, None if it is on another machine
    unheard: bool = False  # the master has known a controller for ABSENT_S


@dataclass(frozen=True)
class PanelState:
    present: bool
    control_on: bool
    gripper_on: bool
    scaling_factor: float
    status_line: str
    tone: Tone = Tone.NORMAL
    stops: bool = False  # whether the robot can stop and pause a motion to a point
    paused: bool = False  # whether it is to pause
    guides: bool = False  # whether a hand can guide the arm
    guided: bool = False  # whether it may now
    policy: bool = False  # whether somebody can let a policy steer the tool
    episodes: bool = False  # whether somebody records episodes


NO_CONTEXT = PanelContext()
UNHEARD = (
    "The ROS master knows a controller, but it has not been heard: it hangs, has ended, or is out of reach. Emergency "
    "Stop can ask it to exit, but not end its process: keep to the red button of the smartPad."
)


def panel_state(status: ControllerStatus | None, now: float, context: PanelContext = NO_CONTEXT) -> PanelState:
    """Returns what the control panel shows at time `now` [s]; only what is known to be on is shown as on."""
    if status is None:
        if context.master_lost:
            return _absent(None, f"Waiting for the ROS master at {context.master}.", Tone.WARNING)
        if context.unheard:
            return _absent(None, UNHEARD, Tone.FAULT)
        return _absent(None, "Waiting for the controller of the arm.", Tone.NORMAL)
    if context.runs is False:
        line = f"The controller has exited. Its last state was {_sentence(status)}"
        return _absent(status, line, Tone.WARNING)
    silence = now - status.received
    if silence > ABSENT_S:
        why = "it hangs" if context.runs else "it exited, hangs, or is out of reach"
        line = f"The controller has been silent for {silence:.0f} s: {why}."
        return _absent(status, line, Tone.FAULT)
    line, tone = _sentence(status), Tone.FAULT if status.mode == Mode.STOPPED else Tone.NORMAL
    if context.master_lost:
        line = f"{line}\nThe ROS master at {context.master} does not answer; this controller still does."
        tone = Tone.WARNING if tone is Tone.NORMAL else tone
    return PanelState(
        *(True, status.control_on, status.gripper_on, status.scaling_factor, line, tone, status.stops, status.paused),
        *("guide" in status.abilities, status.guided),
    )


def factor_text(factor: float) -> str:
    """Returns a scaling factor with two decimals, and with as many as it has where those are more (float32: six)."""
    whole, _, decimals = str(round(factor, 6)).partition(".")
    return f"{whole}.{decimals:0<2}"


def _absent(status: ControllerStatus | None, line: str, tone: Tone) -> PanelState:
    factor, stops = (SCALING_DEFAULT, False) if status is None else (status.scaling_factor, status.stops)
    return PanelState(False, False, False, factor, line, tone, stops)


def _sentence(status: ControllerStatus) -> str:
    limited = f" (limited by: {', '.join(status.limited_by)})" if status.limited_by else ""
    return f"{status.mode}: {status.reason}{limited}"
