"""The arm of the simulated controller in the world: its drives hold the joints of the physics through stiff springs.

The controller's own angles stand behind the gears, the physics' angles before them. Between the two is the elasticity
of the gears: `tau = K (q - q_physics) + D (v - v_physics)` besides what gravity and the planned motion need. So the arm
does not sink and follows exactly where nothing touches it, a table stops it, and what it presses with is what the
springs bear, the torque that the sensors in the joints of the real arm measure. Angles in rad, shape (7,).
"""

from __future__ import annotations

import mujoco
import numpy as np

from rig_simulation.sunrise.robot import JOINTS
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
        self._stiffness, self._damping = np.array(ARM_STIFFNESS), np.array(ARM_DAMPING)
        self._q = self._v = self._v_next = np.zeros(7)
        self._torque = np.zeros(7)
        self._observer_share = world.timestep / (OBSERVER_TIME_S + world.timestep)
        world.add(self)

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Lets one step of the world pass, at whose end the drives stand at q and turn at v.

        Returns:
            torques of touch and load on the joints, shape (7,) [Nm].

        Raises:
            ValueError: dt is not the world's time step [s].
        """
        if abs(dt - self._world.timestep) > 1e-9:
            raise ValueError(f"the arm moves in steps of {dt} s, the world in steps of {self._world.timestep} s")
        self._v_next = v
        self._world.step()
        self._q, self._v = q, v
        torque = -self._spring(q) - self._damping * (v - self._world.data.qvel[self._dofs])
        self._torque = self._torque + self._observer_share * (torque - self._torque)
        return self._torque

    def bind(self, world: World) -> None:
        """Takes the world's model and state."""
        joints = [world.model.joint(name) for name in JOINTS]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._dofs = np.array([joint.dofadr[0] for joint in joints])
        self._strongest = world.model.jnt_actfrcrange[[joint.id for joint in joints], 1]
        self._accelerations, self._efforts = np.zeros(world.model.nv), np.zeros(world.model.nv)

    def before_step(self) -> None:
        """Writes the efforts of the drives; the damping acts in the physics, at the speed after the step."""
        model, data = self._world.model, self._world.data
        self._accelerations[self._dofs] = (self._v_next - self._v) / self._world.timestep
        mujoco.mj_mulM(model, data, self._efforts, self._accelerations)
        held = self._efforts[self._dofs] + data.qfrc_bias[self._dofs]
        data.qfrc_applied[self._dofs] = held + self._spring(self._q) + self._damping * self._v_next

    def _spring(self, q: np.ndarray) -> np.ndarray:
        torque = self._stiffness * (q - self._world.data.qpos[self._qpos])
        return np.minimum(np.maximum(torque, -self._strongest), self._strongest)
