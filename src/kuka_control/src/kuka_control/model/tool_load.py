"""The weight of the tool in the external torques. The toolbox attaches a tool without mass, so the robot's
controller takes the weight of what is on the flange for an external torque. Taken off here, the rest is what touches
the arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from iiwa_kinematics import Kinematics

GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True)
class ToolLoad:
    """The tool on the flange, and what the hand holds."""

    kinematics: Kinematics  # of the arm with its tool
    mass: float  # of the tool [kg]
    center_of_mass: np.ndarray  # in the flange frame, shape (3,) [m]
    up: np.ndarray  # the world's vertical in the base frame, a unit vector, shape (3,)

    def unknown(self, known: bool) -> ToolLoad:
        """Returns what of the tool the robot's controller does not know of; `known`: it was told the tool's mass."""
        return replace(self, mass=0.0) if known else self

    def torques(self, q: np.ndarray, payload: float = 0.0) -> np.ndarray:
        """Returns the torques that the weight makes at the joints q, shape (7,) each [rad], [Nm]. They have the sign
        of external torques. `payload` is the mass of what the hand holds, at the tool point [kg]."""
        if self.mass + payload == 0.0:
            return np.zeros(7)
        kinematics = self.kinematics
        R_base_flange = (kinematics.forward(q) @ kinematics.T_tool_flange)[:3, :3]
        lever = R_base_flange @ (self.center_of_mass - kinematics.T_flange_tool[:3, 3])
        weight = -GRAVITY * self.up
        wrench = np.concatenate([(self.mass + payload) * weight, np.cross(lever, self.mass * weight)])
        return kinematics.jacobian(q).T @ wrench

    def wrench(self, q: np.ndarray, payload: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Returns the part of a reported force [N] and moment [Nm] at the tool point that the weight makes. Shape
        (3,) each, along the tool's axes: what fits the torques best, as the robot's controller finds it too."""
        if self.mass + payload == 0.0:
            return np.zeros(3), np.zeros(3)
        return wrench_at_tool(self.kinematics, q, self.torques(q, payload))


def wrench_at_tool(kinematics: Kinematics, q: np.ndarray, torques: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns force [N] and moment [Nm], shape (3,) each, along and about the tool's axes, that fit the torques
    best. For servo mode, in which the toolbox cannot tell the moment, and before May 2019 not the force either.
    Least squares of J^T w = torques at the joints q, shape (7,) [rad], with external joint torques, shape (7,) [Nm]."""
    rcond = 0.02  # singular values of the Jacobian below this fraction of the greatest say nothing about the wrench
    wrench = np.linalg.lstsq(kinematics.jacobian(q).T, torques, rcond=rcond)[0]
    R_tool_base = kinematics.forward(q)[:3, :3].T
    return R_tool_base @ wrench[:3], R_tool_base @ wrench[3:]
