"""The ReFlex hand in the world: its servos pull the tendons of the physics, its sensors measure them.

Wire and control requests are those of the simulated hand; here its moving parts have masses and contacts. Lengths in m,
angles in rad, forces in N.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from rig_simulation.devices.reflex.hand import SimulatedHand
from rig_simulation.devices.reflex.mechanics import FINGERS, TAXELS
from rig_simulation.devices.reflex.servo import MAX_EFFORT, MAX_TORQUE_NM
from rig_simulation.world.hand_model import PARTS, pad_name, tendon_name
from rig_simulation.world.physics import Part, World

EFFORT_PER_NM = MAX_EFFORT / MAX_TORQUE_NM
FINGER_RATIO, SWIVEL_RATIO = 1.42, 1.5
"""Turns of a motor for one turn of its spool."""

COUNTS_PER_N = 25.0
"""For a force in the middle of a taxel. An assumption: the vendor counts 20 as a touch and shows at most 80."""
TAXEL_REACH_M = 0.005
"""Standard deviation of the sensitivity beside a taxel; it falls to one half at 5.9 mm."""

_TIP_TILT_RAD = np.radians(30.0)
_TAXEL_POSITIONS = {
    "proximal": [(x, 0.0, 0.0154) for x in (0.0189, 0.0268, 0.0347, 0.0426, 0.0506)],
    "distal": [(0.0114, 0.0, 0.0129), (0.0193, 0.0, 0.0129), (0.0272, 0.0, 0.0129), (0.0375, 0.0, 0.0073)],
}
_UP = (0.0, 0.0, 1.0)
_TAXEL_NORMALS = {
    "proximal": [_UP] * 5,
    "distal": [_UP] * 3 + [(np.sin(_TIP_TILT_RAD), 0.0, np.cos(_TIP_TILT_RAD))],
}


class PhysicalMechanics:
    """The moving parts of the hand in a MuJoCo model; see `rig_simulation.devices.reflex.mechanics`."""

    def __init__(self) -> None:
        self._ends: list[float | None] = [None] * FINGERS

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Takes model and state; obstacles remain."""
        self._model, self._data = model, data
        self._tendons = [model.actuator(tendon_name(finger + 1)).id for finger in range(FINGERS)]
        self._swivels = [model.actuator(f"reflex/preshape_{finger}").id for finger in (1, 2)]
        self._joints = {
            part: [model.joint(f"reflex/{part}_joint_{finger + 1}").id for finger in range(FINGERS)] for part in PARTS
        }
        self._farthest = [float(model.jnt_range[joint, 1]) for joint in self._joints["proximal"]]
        self._pads = [{model.geom(pad_name(part, finger + 1)).id: part for part in PARTS} for finger in range(FINGERS)]
        for finger, end in enumerate(self._ends):
            self.block(finger, end)

    def pull(self, spools: Sequence[float] | np.ndarray) -> None:
        """Sets the spool angles of tendons and swivels for the next step."""
        self._data.ctrl[self._tendons] = spools[:FINGERS]
        self._data.ctrl[self._swivels] = spools[FINGERS], -spools[FINGERS]

    def resistance(self, motor: int) -> float:
        """Returns the effort of a motor [0.1 %], from the tension of its tendon or the torques of both swivels."""
        torques = self._data.actuator_force
        if motor < FINGERS:
            return float(torques[self._tendons[motor]]) / FINGER_RATIO * EFFORT_PER_NM
        first, second = self._swivels
        return float(torques[first] - torques[second]) / SWIVEL_RATIO * EFFORT_PER_NM

    def proximal(self, finger: int) -> float:
        """Returns the turn of a knuckle."""
        return self._angle("proximal", finger)

    def distal(self, finger: int) -> float:
        """Returns the bend of a flexure."""
        return self._angle("distal", finger)

    def touch(self, finger: int) -> Sequence[float]:
        """Returns the pressure on the nine taxels of a finger [counts]."""
        pads = self._pads[finger]
        counts = np.zeros(TAXELS)
        for i, geoms in enumerate(self._data.contact.geom):
            for side, sign in ((0, 1.0), (1, -1.0)):
                part = pads.get(int(geoms[side]))
                if part is not None:
                    first = 0 if part == "proximal" else len(_TAXEL_POSITIONS["proximal"])
                    pressure = self._pressure(i, int(geoms[side]), part, sign)
                    counts[first : first + len(pressure)] += pressure
        return counts.tolist()

    def block(self, finger: int, proximal: float | None) -> None:
        """Limits the turn of a knuckle."""
        self._ends[finger] = proximal
        end = self._farthest[finger] if proximal is None else proximal
        self._model.jnt_range[self._joints["proximal"][finger], 1] = end

    def _angle(self, part: str, finger: int) -> float:
        return float(self._data.qpos[self._model.jnt_qposadr[self._joints[part][finger]]])

    def _pressure(self, contact: int, geom: int, part: str, sign: float) -> np.ndarray:
        """Returns the counts that a contact adds to the taxels of a part; sign: +1 if the pad is its first geom."""
        found = self._data.contact[contact]
        wrench = np.zeros(6)
        mujoco.mj_contactForce(self._model, self._data, contact, wrench)
        body = self._model.geom_bodyid[geom]
        R, p = self._data.xmat[body].reshape(3, 3), self._data.xpos[body]
        # The contact's normal points from the first geom to the second, away from the pad if that is the first.
        outward = R.T @ found.frame[:3] * sign
        offset = R.T @ (found.pos - p) - np.array(_TAXEL_POSITIONS[part])
        normals = np.array(_TAXEL_NORMALS[part])
        beside = np.linalg.norm(offset - np.sum(offset * normals, axis=1, keepdims=True) * normals, axis=1)
        pressing = wrench[0] * np.maximum(0.0, normals @ outward)
        return COUNTS_PER_N * pressing * np.exp(-0.5 * (beside / TAXEL_REACH_M) ** 2)


class HandPart(Part):
    """The hand as a part of the world.

    Args:
        seed: of the hand's individual values and noise.

    Attributes:
        simulated: the hand with its electronics, for its wire and its control port.
    """

    def __init__(self, seed: int = 0) -> None:
        self._mechanics = PhysicalMechanics()
        self.simulated = SimulatedHand(seed, self._mechanics)

    def bind(self, world: World) -> None:
        """Takes model and state of the world."""
        self._timestep = world.timestep
        self._mechanics.bind(world.model, world.data)

    def before_step(self) -> None:
        """Steps the servos, which pull the tendons."""
        self.simulated.step(self._timestep)
