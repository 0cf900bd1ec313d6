"""Where two arms stand to each other, from one fixed camera that was calibrated to each of them. `T_first_second =
T_first_camera inverse(T_second_camera)`: the marker board is mounted on one arm, then on the other, and the camera
stays where it is. Small changes of a pose are those of hand_eye.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from common.poses import inverse, read_only
from vision.calibration.hand_eye import HandEyeSolution


@dataclass(frozen=True, eq=False)
class ArmRegistration:
    """The base of the second arm in that of the first one."""

    T_first_second: np.ndarray  # shape (4, 4) [m]
    covariance: np.ndarray  # of small changes of it, shape (6, 6) [m, rad]

    @property
    def position_sd(self) -> np.ndarray:
        """Standard deviations of the position along the first base's axes, shape (3,) [m]."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def turn_sd(self) -> np.ndarray:
        """Standard deviations of the orientation about the first base's axes, shape (3,) [rad]."""
        return np.sqrt(np.diag(self.covariance)[3:])

    def point_sd(self, point: np.ndarray) -> float:
        """Returns the standard deviation of the distance between what both arms take for a `point` of the second one,
        shape (3,) in the first base [m]."""
        J = np.hstack((np.eye(3), -pin.skew(np.asarray(point) - self.T_first_second[:3, 3])))
        return float(np.sqrt(np.trace(J @ self.covariance @ J.T)))


def register(first: HandEyeSolution, second: HandEyeSolution) -> ArmRegistration:
    """Returns the registration of two arms to which the same camera was calibrated, at the same place."""
    T_first_second = first.T_base_camera @ inverse(second.T_base_camera)
    R = T_first_second[:3, :3]
    lever = pin.skew(R @ second.T_base_camera[:3, 3])
    J_first = np.block([[np.eye(3), lever], [np.zeros((3, 3)), np.eye(3)]])
    J_second = -J_first @ np.kron(np.eye(2), R)
    covariance = sum(J @ solution.covariance[6:, 6:] @ J.T for J, solution in ((J_first, first), (J_second, second)))
    return ArmRegistration(read_only(T_first_second), read_only(covariance))
