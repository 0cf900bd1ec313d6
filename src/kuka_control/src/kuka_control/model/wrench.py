"""Force and moment at the tool point from the external joint torques, for servo mode, in which the toolbox cannot tell
the moment, and before May 2019 not the force either."""

from __future__ import annotations

import numpy as np

from iiwa_kinematics import Kinematics

RCOND = 0.02
"""Singular values of the Jacobian below this fraction of the greatest are ignored: there torques say nothing."""


def wrench_at_tool(kinematics: Kinematics, q: np.ndarray, torques: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns force [N] and moment [Nm], shape (3,) each, along and about the tool's axes, that fit the torques best.

    Least squares of J^T w = torques.

    Args:
        kinematics: of the arm with its tool.
        q: joints, shape (7,) [rad].
        torques: external joint torques, shape (7,) [Nm].
    """
    wrench = np.linalg.lstsq(kinematics.jacobian(q).T, torques, rcond=RCOND)[0]
    R_tool_base = kinematics.forward(q)[:3, :3].T
    return R_tool_base @ wrench[:3], R_tool_base @ wrench[3:]
