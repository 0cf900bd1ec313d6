"""The published mode of a controller, and the switches that the operator sets by services."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

from common.modes import Mode
from kuka_control.numbers import PAYLOAD_MAX_KG, SCALING_DEFAULT, SCALING_MAX, SCALING_MIN

IN_DOUBT = (
    "the arm does not move while its measured joints are not believed; switch control off and on once they are right "
    "again, or start the controller anew."
)


AT_REST = (Mode.HOME, Mode.HOLDING, Mode.STOPPED)  # modes in which no motion and no servo mode runs


def check_scaling_factor(factor: float) -> float:
    """Returns the factor; ValueError: it is not finite or outside `SCALING_MIN` to `SCALING_MAX`."""
    if not SCALING_MIN <= factor <= SCALING_MAX:
        raise ValueError(f"the scaling factor {factor:g} is outside {SCALING_MIN:g} to {SCALING_MAX:g}")
    return float(factor)


class ExitInPlace(Enum):
    """Why an arm that a fault has stopped stays where it is when the controller exits, a part of a sentence."""

    IN_DOUBT = "its measured joints are not believed"
    TOUCHED = "it touched something on its way"


@dataclass(frozen=True)
class SwitchState:
    """The position of all switches."""

    control_on: bool = False
    enable_count: int = 0
    gripper_on: bool = False
    scale: float = SCALING_DEFAULT
    exit_requested: bool = False
    exit_in_place: ExitInPlace | None = None  # why the exit was said to leave the arm where it is
    payload: float = 0.0  # of what the hand holds [kg]
    stop_count: int = 0  # how often a motion that runs was asked to stop
    stop_because: str = ""  # the last time, a part of a sentence
    paused: bool = False  # whether the PTP motion that runs is to pause
    soft: bool = False  # whether servo modes begin soft


class SwitchReply(NamedTuple):
    """Whether a request was executed, and one sentence about it."""

    success: bool
    message: str


class Switches:
    """The switches of a controller; `now` is the position of all. `soft`: whether servo modes begin soft at first;
    `stiff_because`: why they cannot, a part of a sentence."""

    def __init__(self, soft: bool = False, stiff_because: str | None = None) -> None:
        self._now = SwitchState(soft=soft)
        self._stiff_because = stiff_because
        self._mode = Mode.STARTING
        self._stopped_because: str | None = None
        self._when_enabled: str | None = None
        self._exit_in_place: ExitInPlace | None = None
        self._held_by: str | None = None
        self._stops = self._pauses = False

    @property
    def now(self) -> SwitchState:
        """The position of all."""
        return self._now

    def report(
        self,
        mode: Mode,
        stopped_because: str | None,
        when_enabled: str | None = None,
        exit_in_place: ExitInPlace | None = None,
        stops: bool = False,
        guided: bool = False,
    ) -> None:
        """Takes the state of the controller, which the replies quote; `when_enabled`: what happens to the present
        desired tool frame once control is switched on; `exit_in_place`: why an exit leaves the arm where it is;
        `stops`: a PTP motion runs, which the robot can stop; `guided`: instead a hand moves the arm."""
        self._stops, self._pauses = stops, stops and not guided
        if self.now.paused and not stops:
            self._now = replace(self.now, paused=False)
        self._mode = mode
        self._stopped_because = stopped_because
        self._when_enabled = when_enabled
        self._exit_in_place = exit_in_place

    def hold(self, why: str) -> None:
        """Switches control off, and keeps it off until `release`; `why` is part of a sentence."""
        self._now = replace(self.now, control_on=False)
        self._held_by = why

    def release(self) -> None:
        """Lets control be switched on again."""
        self._held_by = None

    def set_control(self, on: bool) -> SwitchReply:
        if on and self.now.exit_requested:
            return SwitchReply(False, "Control stays off: the controller is shutting down.")
        if on and self._held_by is not None:
            return SwitchReply(False, f"Control stays off: {self._held_by}.")
        doubted = self._exit_in_place is ExitInPlace.IN_DOUBT
        if on and doubted:
            return SwitchReply(False, f"Control stays {'on' if self.now.control_on else 'off'}: {IN_DOUBT}")
        stopped = self._stopped_because
        before = self.now.control_on
        enable_count = self.now.enable_count + (on and not before)
        self._now = replace(self.now, control_on=on, enable_count=enable_count)
        if not on:
            self.stop_motion("control is off")
        if on and before and stopped:
            return SwitchReply(False, f"The arm is stopped until control is switched off and on again: {stopped}")
        if not on and self._stops:
            return SwitchReply(True, "Control is off, the robot stops the arm, which stays until control is on again.")
        if on == before:
            return SwitchReply(True, f"Control is {'on' if on else 'off'} already.")
        if not on:
            where = "stays where it is until control is on again" if stopped else "goes home"
            where += ", which it cannot be before its measured joints are believed" * doubted
            return SwitchReply(True, f"Control is off, the arm {where}.")
        first = "" if self._mode == Mode.HOME else " The arm goes home first."
        follows = "The arm follows the desired tool frame once it comes."
        return SwitchReply(True, f"Control is on.{first} {self._when_enabled or follows}")

    def stop_motion(self, because: str) -> None:
        """Stops a PTP motion that runs, where the robot can do that; `because` is part of a sentence."""
        self._now = replace(self.now, stop_count=self.now.stop_count + 1, stop_because=because)

    def set_paused(self, on: bool) -> SwitchReply:
        """Pauses the PTP motion that runs, or continues it."""
        if on and not self._pauses:
            return SwitchReply(False, "Nothing is paused: no motion runs that this robot's application can pause.")
        self._now = replace(self.now, paused=on)
        return SwitchReply(True, "The motion is paused." if on else "The motion continues, if one was paused.")

    def set_soft(self, on: bool) -> SwitchReply:
        """Lets the next servo modes begin soft, or stiff."""
        stays = f"The arm stays {'soft' if self.now.soft else 'stiff'}"
        if on and self._stiff_because is not None:
            return SwitchReply(False, f"{stays}: {self._stiff_because}.")
        if self._mode not in AT_REST:
            return SwitchReply(False, f"{stays}: it changes at rest only, but the mode is {self._mode.value}.")
        self._now = replace(self.now, soft=on)
        return SwitchReply(True, f"The arm is {'soft' if on else 'stiff'} whenever it follows from now on.")

    def set_gripper(self, on: bool) -> SwitchReply:
        if on and self.now.exit_requested:
            return SwitchReply(False, "Gripper control stays off: the controller is shutting down.")
        self._now = replace(self.now, gripper_on=on)
        return SwitchReply(True, f"Gripper control is {'on' if on else 'off'}.")

    def set_scale(self, factor: float) -> SwitchReply:
        """Changes the scaling factor; an arm that follows does so from its present pose on."""
        try:
            scale = round(check_scaling_factor(factor), 6)
        except ValueError as error:
            return SwitchReply(False, f"The scaling factor stays {self.now.scale:g}: {error}.")
        self._now = replace(self.now, scale=scale)
        return SwitchReply(True, f"The scaling factor is {scale:g}.")

    def set_payload(self, mass: float) -> SwitchReply:
        """Changes the mass of what the hand holds [kg]. Its weight is taken off the torques that are shown, and sets
        the contact ranges of PTP motions."""
        if not 0.0 <= mass <= PAYLOAD_MAX_KG:
            kept = f"The payload stays {self.now.payload:g} kg"
            return SwitchReply(False, f"{kept}: {mass:g} kg is outside 0 to {PAYLOAD_MAX_KG:g} kg.")
        self._now = replace(self.now, payload=round(mass, 6))
        return SwitchReply(True, f"The payload is {self.now.payload:g} kg.")

    def request_exit(self) -> SwitchReply:
        if self.now.exit_requested:
            return SwitchReply(True, "The controller is shutting down already.")
        off = replace(self.now, control_on=False, gripper_on=False)
        self._now = replace(off, exit_requested=True, exit_in_place=self._exit_in_place)
        if self._held_by is not None:
            return SwitchReply(True, f"The controller exits and leaves the arm as it is: {self._held_by}.")
        if self._exit_in_place is not None:
            return SwitchReply(
                True, f"The controller exits and leaves the arm where it is: {self._exit_in_place.value}."
            )
        return SwitchReply(True, "The arm goes to the zero position, then the controller exits.")
