"""Whether the arm still follows its servo goals, and whether a PTP motion goes on.

The toolbox does not say when a servo mode ended by itself or when a safety stop holds the arm: goals are acknowledged
as ever, and the end of a motion just does not come. The measured joints tell: they stand still while the goal went
away, they fall far behind, or they come no nearer to the end of the motion.
"""

from __future__ import annotations

import numpy as np

FAR_RAD = float(np.radians(20.0))
"""Distance between goal and measured joint that is too far (full joint speed lags about half of it behind)."""

FAR_S = 0.1
"""How long it may be too far [s]."""

AWAY_RAD = float(np.radians(0.5))
"""Distance between goal and measured joint that an arm in servo mode always works off."""

STILL_RAD = float(np.radians(0.02))
"""Joints that moved less than this stand still."""

STILL_S = 0.3
"""How long the arm may stand still away from its goal [s]; a safety stop is to be seen within half a second."""

MOTION_STILL_S = 0.4
"""How long the arm may come no nearer to the end of a PTP motion; a little more than in servo mode, since a reduced
speed override slows it down [s]."""

MOTION_END_S = 1.0
"""How long it may do so before it has begun to move and in the last AWAY_RAD: the controller plans, opens the brakes,
and starts and ends gently, the more so at a reduced override [s]."""

SAMPLES = 10
"""At least so many measurements stand behind a verdict, so that a stall of the loop is not blamed on the arm."""


class TrackingMonitor:
    """Compares servo goals with measured joints, shape (7,) [rad], cycle by cycle."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Starts anew, as after a start of servo mode."""
        self._reference: np.ndarray | None = None
        self._still_since = self._far_since = 0.0
        self._still_samples = self._far_samples = 0

    def step(self, goal: np.ndarray, measured: np.ndarray, now: float) -> str | None:
        """Returns None while the arm follows, else what is wrong, as a part of a sentence."""
        error = np.abs(goal - measured)
        joint = int(np.argmax(error))
        worst = float(error[joint])

        reference = self._reference
        first = reference is None
        moved = reference is None or float(np.max(np.abs(measured - reference))) > STILL_RAD
        if moved or worst <= AWAY_RAD:
            self._reference = measured
            self._still_since, self._still_samples = now, 0
        self._still_samples += 1
        if first or worst <= FAR_RAD:
            self._far_since, self._far_samples = now, 0
        self._far_samples += 1

        degrees = np.degrees(worst)
        if now - self._still_since > STILL_S and self._still_samples > SAMPLES:
            return f"the arm stands still although joint {joint + 1} is {degrees:.1f} deg away from its goal"
        if now - self._far_since > FAR_S and self._far_samples > SAMPLES:
            return f"joint {joint + 1} is {degrees:.1f} deg behind its goal"
        return None


class MotionMonitor:
    """Watches a PTP motion by measured joints, cycle by cycle. How long a motion takes says nothing: the speed override
    of the smartPad is not known here.

    Args:
        q: where the motion ends, shape (7,) [rad].

    Attributes:
        still: for how long the arm has come no nearer [s].
    """

    def __init__(self, q: np.ndarray) -> None:
        self.still = 0.0
        self._q = q
        self._measured: np.ndarray | None = None
        self._nearest = float("inf")
        self._begun = False
        self._since = 0.0
        self._samples = 0

    def step(self, measured: np.ndarray, now: float) -> bool:
        """Returns whether something holds the arm.

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
        allowed = MOTION_STILL_S if self._begun and left > AWAY_RAD else MOTION_END_S
        return self.still > allowed and self._samples > SAMPLES
