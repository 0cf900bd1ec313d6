"""The arm and the ReFlex hand as parts of the world. Lengths in m, angles in rad, forces in N.

The simulated controller has the motor-side angles of the arm, the physics the link-side angles. Between them is the
elasticity of the gears: `tau = K (q - q_physics) + D (v - v_physics)`, added to the torques of gravity and of the
planned motion. So the arm does not sink, follows exactly in free space, and is stopped by a table; the torque of the
springs is what the joint torque sensors of the real arm measure.
The hand's servos pull the tendons of the physics, and its sensors measure them. Wire and control requests are those of
the simulated hand; here its moving parts have masses and contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from rig_description.hand import TAXEL_NORMALS, TAXEL_POSITIONS
from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.devices.reflex.mechanics import FINGERS, MAX_EFFORT, MAX_TORQUE_NM, TAXELS, Mechanics
from rig_simulation.devices.sunrise.robot import JOINTS
from rig_simulation.world.hand_model import PARTS, pad_name, tendon_name
from rig_simulation.world.mjcf import ARM_DAMPING, ARM_STIFFNESS
from rig_simulation.world.physics import Part, World


def named(prefix: str, name: str) -> str:
    """Returns what a part of the robot with this prefix is called in the model; an only robot has none."""
    return f"{prefix}/{name}" if prefix else name


class CarriedJoints(Part):
    """The link side of an arm, an ArmEnvironment: takes where the drives hold it; another arm steps the world.
    `prefix`: of the robot's names in the model."""

    def __init__(self, world: World, prefix: str = "") -> None:
        self._world, self._prefix = world, prefix
        self._timestep = world.timestep
        self._stiffness, self._damping = np.array(ARM_STIFFNESS), np.array(ARM_DAMPING)
        self._q = self._v = self._v_next = np.zeros(7)
        self._torque, self._spring = np.zeros(7), np.zeros(7)  # measured; of the springs at the present angles
        self._drive_torque = np.zeros(7)  # in the last step
        self._dt = self._timestep  # of the present step of the world [s]
        self._q_next = self._q  # of the drives after the next step of the world
        world.add(self)

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Takes the end angles q of the drives; see ArmEnvironment. Raises ValueError if dt differs from the world's
        time step."""
        if abs(dt - self._timestep) > 1e-9:
            raise ValueError(f"The arm steps by {dt} s, but the world by {self._timestep} s.")
        self._q_next = q
        return self._torque

    @property
    def reaction(self) -> np.ndarray:
        """Torques on the drives in the last step of the world, shape (7,) [Nm]."""
        return -self._drive_torque

    @property
    def pushed(self) -> bool:
        """Whether anything pushes on the arm, its hand or what that holds."""
        return bool(self._pushed.any())

    def begin_step(self, dt: float) -> None:
        """Computes the drives' mean speed for a step of the world of `dt` [s]."""
        self._dt = dt
        self._v_next = (self._q_next - self._q) / dt

    def end_step(self) -> None:
        observer_time_s = 0.01  # time constant of the filter by which the controller estimates external torques
        v = self._v_next
        self._q, self._v = self._q_next, v
        self._update_spring()
        torque = v - self._joint_v
        torque *= self._damping
        torque += self._spring
        self._drive_torque = torque.copy()
        torque += self._torque
        torque *= self._dt / (observer_time_s + self._dt)
        self._torque = self._torque - torque

    def bind(self, world: World) -> None:
        model, data = world.model, world.data
        joints = [model.joint(named(self._prefix, name)) for name in JOINTS]
        qpos, dofs = (_run([j.qposadr[0] for j in joints]), _run([j.dofadr[0] for j in joints]))
        self._weakest, self._strongest = model.jnt_actfrcrange[[joint.id for joint in joints]].T.copy()
        # Views of the state, to read and write it.
        self._joint_q, self._joint_v = data.qpos[qpos], data.qvel[dofs]
        self._pushed = data.qfrc_constraint[dofs]  # by contacts of arm, hand and what it holds
        self._bias, self._applied = data.qfrc_bias[dofs], data.qfrc_applied[dofs]
        self._all_a, self._all_efforts = np.zeros(model.nv), np.zeros(model.nv)
        self._a, self._efforts = self._all_a[dofs], self._all_efforts[dofs]
        self._update_spring()

    def before_step(self) -> None:
        """Writes the efforts of the drives; the damping acts in the physics, at the speed after the step."""
        applied = self._applied
        np.subtract(self._v_next, self._v, out=self._a)
        np.divide(self._a, self._dt, out=self._a)
        mujoco.mj_mulM(self._world.model, self._world.data, self._all_efforts, self._all_a)
        np.multiply(self._damping, self._v_next, out=applied)
        np.add(applied, self._efforts, out=applied)
        np.add(applied, self._bias, out=applied)
        np.add(applied, self._spring, out=applied)

    def _update_spring(self) -> None:
        spring = self._spring
        np.subtract(self._q, self._joint_q, out=spring)
        np.multiply(spring, self._stiffness, out=spring)
        np.minimum(spring, self._strongest, out=spring)
        np.maximum(spring, self._weakest, out=spring)


class ArmJoints(CarriedJoints):
    """The joints of the arm that steps the world, and others that are carried along. `pairs`: two steps of the arm are
    one of the world while nothing pushes on the arm, its hand or what that holds; the world then lags by up to one
    step."""

    def __init__(self, world: World, pairs: bool = False, prefix: str = "") -> None:
        super().__init__(world, prefix)
        self._pairs = pairs
        self._waiting = 0  # steps that the world lags
        self._carry: list[Callable[[float], None]] = []
        self._joints: list[CarriedJoints] = [self]

    def carry(self, joints: CarriedJoints, step: Callable[[float], None]) -> None:
        """Lets another arm be carried along: `step` steps it by a time [s], in which it calls `joints.follow`."""
        self._joints.append(joints)
        self._carry.append(step)

    def follow(self, q: np.ndarray, v: np.ndarray, dt: float) -> np.ndarray:
        """Steps the world to the end angles q of the drives at their mean speed; see ArmEnvironment. Raises ValueError
        if dt differs from the world's time step."""
        super().follow(q, v, dt)
        for step in self._carry:
            step(dt)
        self._waiting += 1
        if self._pairs and self._waiting == 1 and not any(joints.pushed for joints in self._joints):
            return self._torque
        for joints in self._joints:
            joints.begin_step(self._waiting * self._timestep)
        self._world.step(self._waiting)
        self._waiting = 0
        for joints in self._joints:
            joints.end_step()
        return self._torque


def _run(addresses: list[int]) -> slice:
    return slice(int(addresses[0]), int(addresses[-1]) + 1)


EFFORT_PER_NM = MAX_EFFORT / MAX_TORQUE_NM
COUNTS_PER_N = 25.0  # in the middle of a taxel. An assumption: the vendor counts 20 as a touch and shows at most 80


class PhysicalMechanics(Mechanics):
    """The moving parts of the hand in a MuJoCo model; `prefix`: of its names there."""

    def __init__(self, prefix: str = "") -> None:
        super().__init__()
        self._prefix = prefix

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._tendons = [model.actuator(self._named(tendon_name(finger + 1))).id for finger in range(FINGERS)]
        self._swivels = [model.actuator(self._named(f"reflex/preshape_{finger}")).id for finger in (1, 2)]
        self._controls, self._forces = data.ctrl[_run(self._tendons + self._swivels)], data.actuator_force
        self._pulled: tuple[float, ...] = ()
        self._joints = {
            part: [model.joint(self._named(f"reflex/{part}_joint_{finger + 1}")).id for finger in range(FINGERS)]
            for part in PARTS
        }
        self._farthest = [float(model.jnt_range[joint, 1]) for joint in self._joints["proximal"]]
        self._pads = [
            {model.geom(self._named(pad_name(part, finger + 1))).id: part for part in PARTS}
            for finger in range(FINGERS)
        ]
        for finger, end in enumerate(self._ends):
            self.block(finger, end)

    def pull(self, spools: Sequence[float] | np.ndarray) -> None:
        """Sets the spool angles of tendons and swivels for the next step."""
        pulled = (*spools, -spools[FINGERS])
        if pulled != self._pulled:
            self._controls[:] = self._pulled = pulled

    def resistance(self, motor: int) -> float:
        """Returns the effort of a motor [0.1 %], from the tension of its tendon or the torques of both swivels."""
        finger_ratio = 1.42  # turns of a motor for one turn of its spool
        swivel_ratio = 1.5
        torque = self._forces.item
        if motor < FINGERS:
            return torque(self._tendons[motor]) / finger_ratio * EFFORT_PER_NM
        first, second = self._swivels
        return (torque(first) - torque(second)) / swivel_ratio * EFFORT_PER_NM

    def proximal(self, finger: int) -> float:
        return self._angle("proximal", finger)

    def distal(self, finger: int) -> float:
        return self._angle("distal", finger)

    def touch(self, finger: int) -> Sequence[float]:
        """Returns the pressure on the nine taxels of a finger [counts]."""
        pads = self._pads[finger]
        counts = np.zeros(TAXELS)
        for i, geoms in enumerate(self._data.contact.geom.tolist()):
            for geom, sign in zip(geoms, (1.0, -1.0)):
                part = pads.get(geom)
                if part is not None:
                    first = 0 if part == "proximal" else len(TAXEL_POSITIONS["proximal"])
                    pressure = self._pressure(i, geom, part, sign)
                    counts[first : first + len(pressure)] += pressure
        return counts.tolist()

    def block(self, finger: int, proximal: float | None) -> None:
        self._ends[finger] = proximal
        end = self._farthest[finger] if proximal is None else proximal
        self._model.jnt_range[self._joints["proximal"][finger], 1] = end

    def _named(self, name: str) -> str:
        return named(self._prefix, name)

    def _angle(self, part: str, finger: int) -> float:
        return float(self._data.qpos[self._model.jnt_qposadr[self._joints[part][finger]]])

    def _pressure(self, contact: int, geom: int, part: str, sign: float) -> np.ndarray:
        """Returns the counts that a contact adds to the taxels of a part; sign: +1 if the pad is its first geom."""
        taxel_reach_m = 0.005  # standard deviation of the sensitivity beside a taxel; it falls to one half at 5.9 mm
        found = self._data.contact[contact]
        wrench = np.zeros(6)
        mujoco.mj_contactForce(self._model, self._data, contact, wrench)
        body = self._model.geom_bodyid[geom]
        R, p = self._data.xmat[body].reshape(3, 3), self._data.xpos[body]
        # The contact's normal points from the first geom to the second, away from the pad if that is the first.
        outward = R.T @ found.frame[:3] * sign
        offset = R.T @ (found.pos - p) - TAXEL_POSITIONS[part]
        normals = TAXEL_NORMALS[part]
        beside = np.linalg.norm(offset - np.sum(offset * normals, axis=1, keepdims=True) * normals, axis=1)
        pressing = wrench[0] * np.maximum(0.0, normals @ outward)
        return COUNTS_PER_N * pressing * np.exp(-0.5 * (beside / taxel_reach_m) ** 2)


class HandPart(Part):
    """The hand as a part of the world; `simulated`: with its electronics, for its wire and its control port."""

    def __init__(self, seed: int = 0, prefix: str = "") -> None:
        self._mechanics = PhysicalMechanics(prefix)
        self.simulated = SimulatedHand(seed, self._mechanics)

    def bind(self, world: World) -> None:
        self._options = world.model.opt
        self._mechanics.bind(world.model, world.data)

    def before_step(self) -> None:
        self.simulated.step(self._options.timestep)
