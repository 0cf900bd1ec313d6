"""The PTP algorithm: every desired tool frame that is far enough away is one PTP motion."""

from __future__ import annotations

from dataclasses import dataclass

from kuka_control.loop.commands import Wait
from kuka_control.loop.control_loop import ControlLoop, Fired, LoopSettings, Outcome
from kuka_control.loop.transitions import PTP_STATES, Trigger


@dataclass(frozen=True)
class PtpSettings(LoopSettings):
    """Settings of the PTP loop besides; `joints_thresh`: smaller joint steps are not executed [rad]."""

    joints_thresh: float


class PtpLoop(ControlLoop[PtpSettings]):
    """Follows the desired tool frame motion by motion."""

    STATES = PTP_STATES
    PICK_UP = "the desired pose"

    def _follow(self, distance: float) -> Outcome:
        return Wait() if distance <= self._settings.joints_thresh else Fired(Trigger.FAR_TARGET)
