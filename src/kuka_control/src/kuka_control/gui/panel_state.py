"""What the control panel shows, and which of its controls make sense now."""

from __future__ import annotations

from dataclasses import dataclass

SCALING_MIN = 0.1
SCALING_MAX = 1.5
SCALING_DEFAULT = 1.0
ABSENT_S = 1.5
"""Without a status for so long the controller counts as absent."""


@dataclass(frozen=True)
class ControllerStatus:
    """The controller's state as it said it last, `received` by this machine's monotonic clock [s]."""

    received: float
    control_on: bool
    gripper_on: bool
    scaling_factor: float
    mode: str
    reason: str
    limited_by: tuple[str, ...] = ()
    host: str = ""
    pid: int = 0


@dataclass(frozen=True)
class PanelState:
    """What the widgets show."""

    present: bool
    control_on: bool
    gripper_on: bool
    scaling_factor: float
    scaling_enabled: bool
    status_line: str


def panel_state(status: ControllerStatus | None, now: float) -> PanelState:
    """Returns what the panel shows at time `now` [s]; nothing is shown as on that was not said to be on just now."""
    if status is None:
        return PanelState(False, False, False, SCALING_DEFAULT, False, "Waiting for the controller of the arm.")
    silence = now - status.received
    if silence > ABSENT_S:
        line = f"The controller has been silent for {silence:.0f} s: it ended or hangs."
        return PanelState(False, False, False, status.scaling_factor, False, line)
    limited = f" (limited by: {', '.join(status.limited_by)})" if status.limited_by else ""
    return PanelState(
        True,
        status.control_on,
        status.gripper_on,
        status.scaling_factor,
        not status.control_on,
        f"{status.mode}: {status.reason}{limited}",
    )
