"""Denavit-Hartenberg parameters of the arms, and how far a calibrated arm is off them.

Joint i turns about the z axis of frame i - 1; from there to frame i:  Rz(q + theta) Tz(d) Tx(a) Rx(alpha)  (the
standard, distal convention). Frame 0 is the base, frame 7 the flange. Neighbouring axes of these arms cross at right
angles, so small faults of the arm are small changes of these parameters.

Source: the table of the KUKA Sunrise Toolbox, whose zero position and directions of turn are those of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.config import choice, text, vector
from common.poses import read_only
from kuka_control.robot_model import ROBOTS, RobotModel

MAX_LENGTH_MM = 5.0
"""An arm that is further off its data sheet was measured wrongly, or the file has another unit or convention."""

MAX_ANGLE_DEG = 1.0
"""Likewise."""


@dataclass(frozen=True)
class DhDeviations:
    """What a calibration found: calibrated less nominal parameters of joints 1 to 7."""

    robot: str = choice(*ROBOTS, doc="the arm that was measured")
    serial: str = text(doc="its serial number")
    date: str = text(doc="when it was measured, in quotes")
    delta_a: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the axis x")
    delta_alpha: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="about the axis x")
    delta_d: np.ndarray = vector(7, "mm", low=-MAX_LENGTH_MM, high=MAX_LENGTH_MM, doc="along the joint's axis z")
    delta_theta: np.ndarray = vector(7, "deg", low=-MAX_ANGLE_DEG, high=MAX_ANGLE_DEG, doc="zero of the joint")

    @property
    def any(self) -> bool:
        """Whether the arm is off its data sheet at all."""
        return any(np.any(delta) for delta in (self.delta_a, self.delta_alpha, self.delta_d, self.delta_theta))


@dataclass(frozen=True, eq=False)
class DhTable:
    """Parameters of joints 1 to 7, each of shape (7,): a, d [m], alpha, theta (at joint zero) [rad]."""

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    theta: np.ndarray

    def plus(self, deviations: DhDeviations) -> DhTable:
        """Returns the table of an arm that is off this one."""
        return DhTable(
            a=read_only(self.a + 1e-3 * deviations.delta_a),
            alpha=read_only(self.alpha + np.radians(deviations.delta_alpha)),
            d=read_only(self.d + 1e-3 * deviations.delta_d),
            theta=read_only(self.theta + np.radians(deviations.delta_theta)),
        )


def nominal_table(model: RobotModel) -> DhTable:
    """Returns the parameters of an arm as in its data sheet, with its media flange."""
    return DhTable(
        a=read_only(np.zeros(7)),
        alpha=read_only(np.radians([-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0])),
        d=read_only([model.base_shoulder, 0.0, model.shoulder_elbow, 0.0, model.elbow_wrist, 0.0, model.wrist_flange]),
        theta=read_only(np.zeros(7)),
    )
