"""Whether the arm still follows its servo goals.

The toolbox does not report that servo mode ended by itself or that a safety stop holds the arm: it still acknowledges
goals. The measured joints show it: they stand still while the goal moves away, or they fall far behind.
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

SAMPLES = 10
"""A verdict needs more measurements than this, so that a stall of the loop is not blamed on the arm."""


class TrackingMonitor:
    """Compares servo goals with measured joints, shape (7,) [rad], cycle by cycle, from the start of servo mode."""

    def __init__(self) -> None:
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
