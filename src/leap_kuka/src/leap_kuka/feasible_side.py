"""The side of the base on which a desired tool is feasible: in front of it, and above its foot, else the controller
ends. A hand that is drawn back or put down takes the tool to a border before that, along which it slides."""

from __future__ import annotations

import numpy as np

from leap_kuka.config import ArmPlacement
from leap_kuka.numbers import ABOVE_M, AHEAD_M
from leap_kuka.scaling import Scaling


class FeasibleSide:
    """The borders of one arm, in its base frame."""

    def __init__(self, arm: ArmPlacement) -> None:
        self._forward = arm.center_line / np.linalg.norm(arm.center_line)
        self._least = min(AHEAD_M, 0.5 * float(self._forward @ arm.ws_center))

    def back(self, position: np.ndarray, scaling: Scaling) -> np.ndarray:
        """Returns the way from a desired position, shape (3,) [m], to its border, zero on the feasible side."""
        scaled = scaling.scaled(position)
        ahead = max(self._least - float(self._forward @ scaled), 0.0)
        above = max(ABOVE_M - float(scaled[2]), 0.0)
        return (ahead * self._forward + np.array([0.0, 0.0, above])) / (1.0 if scaling.fault else scaling.factor)
