"""Whether the arm still follows its servo goals, and whether something holds it on a PTP motion."""

from __future__ import annotations

import numpy as np

from kst import PtpApproach
from kuka_control.loop.commands import Event

FAR_RAD = float(np.radians(20.0))  # goal and joint are too far apart (full speed lags about half of it behind)
FAR_S = 0.1  # how long it may be too far [s]
AWAY_RAD = float(np.radians(0.5))  # distance between goal and measured joint that an arm in servo mode always works off
STILL_RAD = float(np.radians(0.02))  # joints that moved less than this stand still
STILL_S = 0.3  # how long the arm may stand still away from its goal [s]; a safety stop shows within half a second
SAMPLES = 10  # a verdict needs more measurements than this, so that a stall of the loop is not blamed on the arm
UNKNOWN_S = 0.5  # so long at most are goals sent that lie away from the last known joints [s]
CYCLE_S = 0.03  # of a longer time between two looks this much counts: no goals were sent meanwhile [s]
HELD_S = 0.4  # an arm that came no nearer for this time is held; longer than in servo mode: reduced override [s]


class TrackingMonitor:
    """Compares servo goals with measured joints, shape (7,) [rad], cycle by cycle, from the start of servo mode.

    The toolbox does not report that servo mode ended by itself or that a safety stop holds the arm: it still
    acknowledges goals. The measured joints show it: they stand still while the goal moves away, or fall far behind.
    """

    def __init__(self) -> None:
        self._reference: list[float] | None = None
        self._measured: np.ndarray | None = None
        self._still_since = self._far_since = 0.0
        self._still_samples = self._far_samples = 0
        self._looked, self._unknown = 0.0, 0.0

    def step(self, goal: np.ndarray, measured: np.ndarray, now: float) -> str | None:
        """Returns None while the arm follows, else what is wrong, as a part of a sentence.

        `measured` are the newest joints, the same object until newer ones come.
        """
        fresh, self._measured = measured is not self._measured, measured
        passed, self._looked = min(now - self._looked, CYCLE_S), now
        joints = measured.tolist()
        errors = [abs(a - b) for a, b in zip(goal.tolist(), joints)]
        worst = max(errors)
        self._unknown = 0.0 if fresh or worst <= AWAY_RAD else self._unknown + passed
        if self._unknown > UNKNOWN_S:
            return f"no measured joints came for {UNKNOWN_S:g} s while the goals moved on"

        reference = self._reference
        if reference is None or worst <= AWAY_RAD or max([abs(a - b) for a, b in zip(joints, reference)]) > STILL_RAD:
            self._reference = joints
            self._still_since, self._still_samples = now, 0
        self._still_samples += fresh
        if reference is None or worst <= FAR_RAD:
            self._far_since, self._far_samples = now, 0
        self._far_samples += fresh

        if now - self._still_since > STILL_S and self._still_samples > SAMPLES:
            joint = 1 + errors.index(worst)
            return f"the arm stands still although joint {joint} is {np.degrees(worst):.1f} deg away from its goal"
        if now - self._far_since > FAR_S and self._far_samples > SAMPLES:
            return f"joint {1 + errors.index(worst)} is {np.degrees(worst):.1f} deg behind its goal"
        return None


HELD_AT_ENDS_S = 1.0
"""The same before the arm has begun to move and in the last AWAY_RAD: the controller plans, opens the brakes, and
starts and stops gently, the more so at a reduced override [s]."""


class PtpSupervision:
    """Watches one PTP motion by measured joints, cycle by cycle.

    The toolbox does not report a safety stop: the end of the motion just does not come, and the joints come no nearer
    to the goal. The duration of a motion says nothing, because the smartPad's speed override is not known.

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

        `measured` are the newest joints, shape (7,) [rad], the same object until newer ones come; `now` is monotonic.
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
