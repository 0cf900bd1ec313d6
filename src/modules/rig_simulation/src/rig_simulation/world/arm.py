"""The arm of the simulated controller in the world: its drives hold the joints of the physics through stiff springs.

The controller's own angles stand behind the gears, the physics' angles before them. Between the two is the elasticity
of the gears: `tau = K (q - q_physics) + D (v - v_physics)` besides what gravity and the planned motion need. So the arm
does not sink and follows exactly where nothing touches it, a table stops it, and what it presses with is what the
springs bear, the torque that the sensors in the joints of the real arm measure. Angles in rad, shape (7,).
"""

from __future__ import annotations

import mujoco
import numpy as np

from rig_simulation.devices.sunrise.robot import JOINTS
from rig_simulation.world.physics import Part, World
from rig_simulation.world.robot import ARM_DAMPING, ARM_STIFFNESS

OBSERVER_TIME_S = 0.01
"""Torques from outside are known only so fast: the controller takes them from measured torques by a filter."""


class ArmJoints(Part):
    """The physics' side of the arm; the controller's arm has it as its surroundings.

    It steps the world each time that the arm moves on, so both have one time.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._timestep = world.timestep
        self._stiffness, self._damping = np.array(ARM_STIFFNESS), np.array(ARM_DAMPING)
        self._q = self._v = self._v_next = np.zeros(7)
        self._torque = np.zeros(7)
        self._observer_share = self._timestep / (OBSERVER_TIME_S + self._timestep)
        world.add(self)

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Lets one step of the world pass, at whose end the drives stand at q and turn at v.

        Returns:
            torques of touch and load on the joints, shape (7,) [Nm].

        Raises:
            ValueError: dt is not the world's time step [s].
        """
        if abs(dt - self._timestep) > 1e-9:
            raise ValueError(f"the arm moves in steps of {dt} s, the world in steps of {self._timestep} s")
        self._v_next = v
        self._world.step()
        self._q, self._v = q, v
        torque = -self._spring() - self._damping * (v - self._joint_v)
        self._torque = self._torque + self._observer_share * (torque - self._torque)
        return self._torque

    def bind(self, world: World) -> None:
        """Takes the world's model and state."""
        model, data = world.model, world.data
        joints = [model.joint(name) for name in JOINTS]
        qpos, dofs = (_run([j.qposadr[0] for j in joints]), _run([j.dofadr[0] for j in joints]))
        self._strongest = model.jnt_actfrcrange[[joint.id for joint in joints], 1]
        # Views of the state: they show and set what is there now.
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
    """Returns addresses that follow each other as a slice."""
    return slice(int(addresses[0]), int(addresses[-1]) + 1)
