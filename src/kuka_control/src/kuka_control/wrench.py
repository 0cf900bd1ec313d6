"""The moment at the tool point from the external joint torques, for servo mode, in which the toolbox cannot tell it."""

from __future__ import annotations

import numpy as np

from kuka_control.kinematics import Kinematics

RCOND = 0.02
"""Directions in which the arm is so near to a singular pose that torques tell nothing about the wrench are left out."""


def moment_at_tool(kinematics: Kinematics, q: np.ndarray, torques: np.ndarray) -> np.ndarray:
    """Returns the moment, shape (3,) [Nm], about the tool's axes, that fits the torques best: least squares of J^T w.

    Args:
        kinematics: of the arm with its tool.
        q: joints, shape (7,) [rad].
        torques: external joint torques, shape (7,) [Nm].
    """
    wrench = np.linalg.lstsq(kinematics.jacobian(q).T, torques, rcond=RCOND)[0]
    return kinematics.forward(q)[:3, :3].T @ wrench[3:]
