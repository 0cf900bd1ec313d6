"""The file of a calibrated arm: how far its Denavit-Hartenberg parameters are off those of the data sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import choice, text, vector
from iiwa_kinematics import ROBOTS, DhParameters

MAX_LENGTH_MM = 5.0
"""A larger deviation is a wrong measurement, or the file has another unit or convention."""

MAX_ANGLE_DEG = 1.0
"""Likewise."""


@dataclass(frozen=True)
class DhDeviations:
    """Calibrated less nominal parameters of joints 1 to 7, each of shape (7,)."""

    robot: str = choice(*ROBOTS, doc="the arm that was measured")
    serial: str = text(doc="its serial number")
    date: str = text(doc="when it was measured, in quotes")
    delta_a: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the axis x")
    delta_alpha: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="about the axis x")
    delta_d: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the joint's axis z")
    delta_theta: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="zero of the joint")

    @property
    def parameters(self) -> DhParameters:
        """The deviations in m and rad."""
        return DhParameters(
            a=1e-3 * self.delta_a,
            alpha=np.radians(self.delta_alpha),
            d=1e-3 * self.delta_d,
            theta=np.radians(self.delta_theta),
        )
