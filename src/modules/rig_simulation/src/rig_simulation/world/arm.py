"""The arm of the simulated controller in the world: its drives hold the joints of the physics through stiff springs.

The controller has the motor-side angles, the physics the link-side angles. Between them is the elasticity of the gears:
`tau = K (q - q_physics) + D (v - v_physics)`, added to the torques of gravity and of the planned motion. So the arm
does not sink, follows exactly in free space, and is stopped by a table; the torque of the springs is what the joint
torque sensors of the real arm measure. Angles in rad, shape (7,).
"""

from __future__ import annotations

import mujoco
import numpy as np

from rig_simulation.devices.sunrise.robot import JOINTS
from rig_simulation.world.physics import Part, World
from rig_simulation.world.robot import ARM_DAMPING, ARM_STIFFNESS

OBSERVER_TIME_S = 0.01
"""Time constant of the filter with which the controller estimates external torques from measured ones."""


class ArmJoints(Part):
    """The link side of the arm; the environment of the controller's arm.

    It steps the world with each step of the arm, so both share one time.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._timestep = world.timestep
        self._stiffness, self._damping = np.array(ARM_STIFFNESS), np.array(ARM_DAMPING)
        self._q = self._v = self._v_next = np.zeros(7)
        self._torque = np.zeros(7)
        self._observer_gain = self._timestep / (OBSERVER_TIME_S + self._timestep)
        world.add(self)

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Steps the world once, to the end angles q and speeds v of the drives.

        Returns:
            torques of contacts and load on the joints, shape (7,) [Nm].

        Raises:
            ValueError: dt differs from the world's time step.
        """
        if abs(dt - self._timestep) > 1e-9:
            raise ValueError(f"The arm steps by {dt} s, but the world by {self._timestep} s.")
        self._v_next = v
        self._world.step()
        self._q, self._v = q, v
        torque = -self._spring() - self._damping * (v - self._joint_v)
        self._torque = self._torque + self._observer_gain * (torque - self._torque)
        return self._torque

    def bind(self, world: World) -> None:
        """Takes model and state of the world."""
        model, data = world.model, world.data
        joints = [model.joint(name) for name in JOINTS]
        qpos, dofs = (_run([j.qposadr[0] for j in joints]), _run([j.dofadr[0] for j in joints]))
        self._strongest = model.jnt_actfrcrange[[joint.id for joint in joints], 1]
        # Views of the state, to read and write it.
        self._joint_q, self._joint_v = data.qpos[qpos], data.qvel[dofs]
        self._bias, self._applied = data.qfrc_bias[dofs], data.qfrc_applied[dofs]
        self._all_a, self._all_efforts = np.zeros(model.nv), np.zeros(model.nv)
        self._a, self._efforts = self._all_a[dofs], self._all_efforts[dofs]

    def before_step(self) -> None:
        """Writes the efforts of the drives; the damping acts in the physics, at the speed after the step."""
        self._a[:] = (self._v_next - self._v) / self._timestep
        mujoco.mj_mulM(self._world.model, self._world.data, self._all_efforts, self._all_a)
        self._applied[:] = self._efforts + self._bias + self._spring() + self._damping * self._v_next

    def _spring(self) -> np.ndarray:
        torque = self._stiffness * (self._q - self._joint_q)
        return np.minimum(np.maximum(torque, -self._strongest), self._strongest)


def _run(addresses: list[int]) -> slice:
    """Returns consecutive addresses as a slice."""
    return slice(int(addresses[0]), int(addresses[-1]) + 1)
