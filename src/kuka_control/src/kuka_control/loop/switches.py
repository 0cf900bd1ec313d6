"""The switches that the operator sets by services, and the sentences of the replies."""

from __future__ import annotations

from dataclasses import dataclass, replace

from kuka_control.model.mode import Mode
from kuka_control.model.scaling import SCALING_DEFAULT, check_scaling_factor


@dataclass(frozen=True)
class SwitchState:
    """The position of all switches."""

    control_on: bool = False
    enable_count: int = 0
    gripper_on: bool = False
    scale: float = SCALING_DEFAULT
    exit_requested: bool = False


@dataclass(frozen=True)
class SwitchReply:
    """Whether a request was executed, and one sentence about it."""

    success: bool
    message: str


class Switches:
    """The switches of a controller."""

    def __init__(self) -> None:
        self._now = SwitchState()
        self._mode = Mode.STARTING
        self._stopped_because: str | None = None
        self._held_by: str | None = None

    def read(self) -> SwitchState:
        """Returns the position of all switches."""
        return self._now

    def report(self, mode: Mode, stopped_because: str | None) -> None:
        """Takes the state of the controller, which the replies quote."""
        self._mode, self._stopped_because = mode, stopped_because

    def hold(self, why: str) -> None:
        """Switches control off, and keeps it off until `release`; `why` is part of a sentence."""
        self._now = replace(self._now, control_on=False)
        self._held_by = why

    def release(self) -> None:
        """Lets control be switched on again."""
        self._held_by = None

    def set_control(self, on: bool) -> SwitchReply:
        """Switches control of the arm on or off."""
        if on and self._now.exit_requested:
            return SwitchReply(False, "Control stays off: the controller is shutting down.")
        if on and self._held_by is not None:
            return SwitchReply(False, f"Control stays off: {self._held_by}.")
        stopped, before = self._stopped_because, self._now.control_on
        enable_count = self._now.enable_count + (on and not before)
        self._now = replace(self._now, control_on=on, enable_count=enable_count)
        if on and before and stopped:
            return SwitchReply(False, f"The arm is stopped until control is switched off and on again: {stopped}")
        if on == before:
            return SwitchReply(True, f"Control is {'on' if on else 'off'} already.")
        if not on:
            where = "stays where it is until control is on again" if stopped else "goes home"
            return SwitchReply(True, f"Control is off, the arm {where}.")
        if self._mode == Mode.HOME:
            return SwitchReply(True, "Control is on, the arm follows the desired tool frame.")
        return SwitchReply(True, "Control is on, the arm goes home first and then follows the desired tool frame.")

    def set_gripper(self, on: bool) -> SwitchReply:
        """Switches the flag on the topic kuka/gripper_control."""
        if on and self._now.exit_requested:
            return SwitchReply(False, "Gripper control stays off: the controller is shutting down.")
        self._now = replace(self._now, gripper_on=on)
        return SwitchReply(True, f"Gripper control is {'on' if on else 'off'}.")

    def set_scale(self, factor: float) -> SwitchReply:
        """Changes the scaling factor, while control is off."""
        if self._now.control_on:
            return SwitchReply(
                False,
                f"The scaling factor stays {self._now.scale:g}: it cannot change while control is on.",
            )
        try:
            scale = round(check_scaling_factor(factor), 6)
        except ValueError as error:
            return SwitchReply(False, f"The scaling factor stays {self._now.scale:g}: {error}.")
        self._now = replace(self._now, scale=scale)
        return SwitchReply(True, f"The scaling factor is {scale:g}.")

    def request_exit(self) -> SwitchReply:
        """Requests the motion to the zero position and the exit."""
        if self._now.exit_requested:
            return SwitchReply(True, "The controller is shutting down already.")
        self._now = replace(self._now, control_on=False, gripper_on=False, exit_requested=True)
        if self._held_by is not None:
            return SwitchReply(True, f"The controller exits and leaves the arm as it is: {self._held_by}.")
        return SwitchReply(True, "The arm goes to the zero position, then the controller exits.")
