"""Whether a PTP motion continues or something holds the arm.

The toolbox does not report a safety stop: the end of the motion just does not come. The measured joints show it, since
they come no nearer to the end. How long a motion takes says nothing: the speed override of the smartPad is not known.
"""

from __future__ import annotations

import numpy as np

from kuka_control.loop.commands import Event
from kuka_control.loop.tracking import AWAY_RAD, SAMPLES, STILL_RAD

HELD_S = 0.4
"""An arm that came no nearer for this time is held; longer than in servo mode, because of a reduced override [s]."""

HELD_AT_ENDS_S = 1.0
"""Likewise before the arm has begun to move and in the last AWAY_RAD: the controller plans, opens the brakes, and
starts and stops gently, the more so at a reduced override [s]."""


class PtpSupervision:
    """Watches one PTP motion by measured joints, cycle by cycle.

    Args:
        name: the goal in words, such as "home".
        q: the goal, shape (7,) [rad].

    Attributes:
        held: whether something holds the arm now.
        was_held: whether something held it since the motion began.
        still: for how long the arm has come no nearer [s].
    """

    def __init__(self, name: str, q: np.ndarray) -> None:
        self.name = name
        self.held = self.was_held = False
        self.still = 0.0
        self._q = q
        self._measured: np.ndarray | None = None
        self._nearest = float("inf")
        self._begun = False
        self._since = 0.0
        self._samples = 0

    def step(self, measured: np.ndarray, now: float) -> Event | None:
        """Returns what is to be reported: the arm is held from now on, or is free again.

        Args:
            measured: the newest joints that are known, shape (7,) [rad]; the same object until newer ones come.
            now: monotonic time [s].
        """
        left = float(np.max(np.abs(self._q - measured)))
        if left < self._nearest - STILL_RAD:
            self._begun = self._measured is not None
            self._nearest, self._since, self._samples = left, now, 0
        self._samples += measured is not self._measured
        self._measured = measured
        self.still = now - self._since
        allowed = HELD_S if self._begun and left > AWAY_RAD else HELD_AT_ENDS_S
        before, self.held = self.held, self.still > allowed and self._samples > SAMPLES
        self.was_held |= self.held
        if self.held == before:
            return None
        if self.held:
            return Event(
                "error",
                f"The motion to {self.name} does not continue, {np.degrees(left):.1f} deg are left; if a safety stop "
                "holds the arm, free the arm and press run on the smartPad.",
            )
        return Event("info", f"The arm moves on to {self.name} and stays there until control goes off and on again.")
