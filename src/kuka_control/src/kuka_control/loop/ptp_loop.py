"""The PTP algorithm: every desired tool frame that is far enough away is one PTP motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kuka_control.loop.commands import Command, Observation, Wait
from kuka_control.loop.control_loop import ControlLoop, LoopSettings
from kuka_control.model.target import Target


@dataclass(frozen=True)
class PtpSettings(LoopSettings):
    """What the PTP loop needs to know besides.

    Attributes:
        joints_thresh: smaller joint steps are not executed [rad].
    """

    joints_thresh: float


class PtpLoop(ControlLoop[PtpSettings]):
    """Follows the desired tool frame motion by motion."""

    def _follow(self, seen: Observation, target: Target, now: float) -> Command:
        assert target.q is not None, "only what can be reached is followed"
        if np.max(np.abs(target.q - seen.joints)) <= self._settings.joints_thresh:
            return Wait()
        velocity = self._settings.velocity_home
        return self._ptp(seen, "the desired pose", target.q, velocity, "pick_up", self._at_rest, now)
