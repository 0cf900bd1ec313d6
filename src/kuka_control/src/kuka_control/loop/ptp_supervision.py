"""Detects that something holds the arm on a PTP motion.

The toolbox does not report a safety stop: the end of the motion just does not come. The measured joints show it, since
they come no nearer to the goal. The duration of a motion says nothing, because the speed override of the smartPad is
not known.
"""

from __future__ import annotations

import numpy as np

from kst import PtpApproach
from kuka_control.loop.commands import Event
from kuka_control.loop.tracking import AWAY_RAD, SAMPLES

HELD_S = 0.4
"""An arm that came no nearer for this time is held; longer than in servo mode, because of a reduced override [s]."""

HELD_AT_ENDS_S = 1.0
"""The same before the arm has begun to move and in the last AWAY_RAD: the controller plans, opens the brakes, and
starts and stops gently, the more so at a reduced override [s]."""


class PtpSupervision:
    """Watches one PTP motion by measured joints, cycle by cycle.

    Args:
        name: the goal in words, such as "home".
        q: the goal, shape (7,) [rad].

    Attributes:
        held: whether something holds the arm now.
        was_held: whether something held it since the motion began.
    """

    def __init__(self, name: str, q: np.ndarray) -> None:
        self.name = name
        self.held = self.was_held = False
        self._approach = PtpApproach(q)

    @property
    def still(self) -> float:
        """Time since the arm came nearer to the goal [s]."""
        return self._approach.still

    def step(self, measured: np.ndarray, now: float) -> Event | None:
        """Returns the event to report when something begins to hold the arm, and when the arm is free again.

        Args:
            measured: the newest joints, shape (7,) [rad]; the same object until newer ones come.
            now: monotonic time [s].
        """
        approach = self._approach
        approach.observe(measured, now)
        allowed = HELD_S if approach.begun and approach.remaining > AWAY_RAD else HELD_AT_ENDS_S
        before, self.held = self.held, approach.still > allowed and approach.samples > SAMPLES
        self.was_held |= self.held
        if self.held == before:
            return None
        if self.held:
            return Event(
                "error",
                f"The motion to {self.name} does not continue, {np.degrees(approach.remaining):.1f} deg are left; "
                "if a safety stop holds the arm, free the arm and press run on the smartPad.",
            )
        return Event("info", f"The arm moves on to {self.name} and stays there until control goes off and on again.")
