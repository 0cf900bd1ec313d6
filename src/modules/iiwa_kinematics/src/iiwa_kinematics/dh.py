"""Denavit-Hartenberg parameters of the arms.

Joint i turns about the z axis of frame i - 1; from there to frame i:  Rz(q + theta) Tz(d) Tx(a) Rx(alpha)  (the
standard, distal convention). Frame 0 is the base, frame 7 the flange. Neighbouring axes of these arms cross at right
angles, so small errors of the arm are small changes of these parameters.

Source: the table of the KUKA Sunrise Toolbox, whose zero position and directions of rotation are those of the arm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iiwa_kinematics.poses import read_only
from iiwa_kinematics.robot_model import RobotModel


@dataclass(frozen=True, eq=False)
class DhParameters:
    """Parameters of joints 1 to 7, or their deviations from those of the data sheet.

    Attributes:
        a: along x, shape (7,) [m].
        alpha: about x, shape (7,) [rad].
        d: along the joint's axis z, shape (7,) [m].
        theta: about z, at joint zero, shape (7,) [rad].
    """

    a: np.ndarray
    alpha: np.ndarray
    d: np.ndarray
    theta: np.ndarray

    @property
    def any(self) -> bool:
        """Whether a parameter is not zero."""
        return any(np.any(values) for values in (self.a, self.alpha, self.d, self.theta))

    def plus(self, deviations: DhParameters) -> DhParameters:
        """Returns the parameters of an arm with these deviations."""
        return DhParameters(
            a=read_only(self.a + deviations.a),
            alpha=read_only(self.alpha + deviations.alpha),
            d=read_only(self.d + deviations.d),
            theta=read_only(self.theta + deviations.theta),
        )

    def frames(self, q: np.ndarray) -> np.ndarray:
        """Returns the poses of frames 0 to 7 in the base, shape (8, 4, 4) [m], at joints q, shape (7,) [rad]."""
        angle = np.asarray(q, dtype=float) + self.theta
        c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(self.alpha), np.sin(self.alpha)
        zero, one = np.zeros(7), np.ones(7)
        links = np.array([
            [c, -s * ca, s * sa, self.a * c],
            [s, c * ca, -c * sa, self.a * s],
            [zero, sa, ca, self.d],
            [zero, zero, zero, one],
        ]).transpose(2, 0, 1)  # fmt: skip
        frames = np.empty((8, 4, 4))
        frames[0] = np.eye(4)
        for i, link in enumerate(links):
            frames[i + 1] = frames[i] @ link
        return frames


def nominal_parameters(model: RobotModel) -> DhParameters:
    """Returns the parameters of an arm as in its data sheet, with its media flange."""
    return DhParameters(
        a=read_only(np.zeros(7)),
        alpha=read_only(np.radians([-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0])),
        d=read_only([model.base_shoulder, 0.0, model.shoulder_elbow, 0.0, model.elbow_wrist, 0.0, model.wrist_flange]),
        theta=read_only(np.zeros(7)),
    )
