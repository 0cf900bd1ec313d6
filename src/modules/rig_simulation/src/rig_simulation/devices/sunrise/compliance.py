"""The servo mode of an arm that is soft: springs and dampers at its joints or at its tool, or only friction, when a
hand moves it. They pull to a trajectory towards the goal; what touches the arm, and a weight that nobody stated, push
it off.

The damping is that of each spring with the mass that it moves: D = 2 zeta sqrt(K m). Source: Albu-Schaeffer, Ott,
Hirzinger, A unified passivity-based control framework for position, torque and impedance control, 2007."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin

from rig_simulation.devices.sunrise.robot import Drives, Robot

FRACTION = 0.25  # of speed and acceleration that the application lets the trajectory have
TRAJECTORY_TIME_S = 0.02
# Assumptions: inertia of the drives as their torque control leaves it [kg m^2], its friction, and the damping of an arm
# that floats: 10 N at the tool move it by some 0.3 m/s [Nms/rad]
DRIVES_INERTIA = np.array([0.3, 0.3, 0.2, 0.2, 0.08, 0.04, 0.04])
FRICTION = np.array([10.0, 10.0, 5.0, 5.0, 2.0, 1.0, 1.0])
FLOATING = np.array([30.0, 30.0, 20.0, 20.0, 12.0, 10.0, 4.0])
MM_PER_M = 1000.0


class GivesUp(ValueError):
    """The controller ends the motion, and says why."""


@dataclasses.dataclass(frozen=True)
class Softness:
    """How the arm is soft. `kind`: JOINTS, with seven stiffnesses [Nm/rad] and the damping; TOOL, with six stiffnesses
    [N/m], [Nm/rad], damping, stiffness of the null space, greatest force [N], moment [Nm], deviation [mm],
    [rad]; FLOAT."""

    kind: str
    numbers: tuple[float, ...] = ()


class SoftServo:
    """A servo motion from rest at the joints q, shape (7,) [rad]; `acceleration`: the arm's limits, shape (7,)."""

    def __init__(
        self, robot: Robot, softness: Softness, T_flange_tool: np.ndarray, q: np.ndarray, acceleration: np.ndarray
    ) -> None:
        self._robot, self._softness, self._tool = robot, softness, T_flange_tool
        self._drives = Drives(FRACTION * robot.max_speed, FRACTION * acceleration, TRAJECTORY_TIME_S)
        self._q, self._v = q, np.zeros(7)  # of the trajectory

    def step(self, goal: np.ndarray, q: np.ndarray, v: np.ndarray, torque: np.ndarray, dt: float) -> np.ndarray:
        """Returns the speeds of the joints after `dt` [s] under external torques, shape (7,) [Nm]; raises GivesUp if a
        limit is exceeded."""
        self._v = self._drives.towards(goal - self._q, self._v, dt)
        self._q = self._q + self._v * dt
        M = self._robot.mass_matrix(q) + np.diag(DRIVES_INERTIA)
        if self._softness.kind == "TOOL":
            spring, damping = self._at_tool(q, v, M)
        else:
            spring, damping = self._at_joints(q, M)
        friction = np.diag(FLOATING if self._softness.kind == "FLOAT" else FRICTION)
        pushed = M @ v + dt * (spring + damping @ self._v + torque)
        after = np.linalg.solve(M + dt * (damping + friction), pushed)
        return np.clip(after, -self._robot.max_speed, self._robot.max_speed)

    def _at_joints(self, q: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the springs' torques, shape (7,), and the damping, shape (7, 7)."""
        if self._softness.kind == "FLOAT":
            return np.zeros(7), np.zeros((7, 7))
        K, zeta = np.array(self._softness.numbers[:7]), self._softness.numbers[7]
        return K * (self._q - q), np.diag(2.0 * zeta * np.sqrt(K * np.diag(M)))

    def _at_tool(self, q: np.ndarray, v: np.ndarray, M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        singular = 1e-6
        n = self._softness.numbers
        K, zeta, null_space, most_path = np.array(n[:6]), n[6], n[7], [n[10] / MM_PER_M] * 3 + [n[11]] * 3
        T, T_goal = (self._robot.flange(each) @ self._tool for each in (q, self._q))
        R = T[:3, :3].T
        error = np.concatenate([R @ (T_goal[:3, 3] - T[:3, 3]), pin.log3(R @ T_goal[:3, :3])])
        J = self._robot.jacobian(q, self._tool)
        moves = J @ np.linalg.solve(M, J.T)
        D = 2.0 * zeta * np.sqrt(K / (np.diag(moves) + singular))
        wrench = K * error
        _within("the force", wrench + D * (J @ (self._v - v)), [n[8]] * 3 + [n[9]] * 3)
        _within("the path's deviation", error, most_path)
        # Torques of the null space move nothing at the tool
        J_bar = np.linalg.solve(M, J.T) @ np.linalg.inv(moves + singular * np.eye(6))
        N = np.eye(7) - J.T @ J_bar.T
        own = 2.0 * zeta * np.sqrt(null_space * np.diag(M))
        spring = J.T @ wrench + N @ (null_space * (self._q - q))
        return spring, J.T @ np.diag(D) @ J + N @ np.diag(own) @ N.T


def _within(what: str, values: np.ndarray, limits: list[float]) -> None:
    for value, limit in zip(values.tolist(), limits):
        if not abs(value) <= limit:
            raise GivesUp(f"{what} is {value:.3g}, more than {limit:g}")
