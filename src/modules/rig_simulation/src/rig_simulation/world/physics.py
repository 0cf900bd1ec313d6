"""The physics of the world: one model, one state, one clock. Not thread-safe: its owner holds a lock. Parts drive the
robot's joints: the arm, the hand. In each step the world computes positions and speeds, lets each part write its
efforts (`data.ctrl`, `data.qfrc_applied` of its own joints), and integrates."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from common.errors import DeviceError
from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_about
from rig_simulation.world.model import TIMESTEP_S, WorldDescription, build_model
from rig_simulation.world.scene import SceneObject, WorldScene, scene_from, table_pose

ROBOT = re.compile(r"(\w+/)*(kuka|reflex)/|panel")  # how names of its bodies begin
DIVERGED = [int(mujoco.mjtWarning.__members__[f"mjWARN_BAD{what}"]) for what in ("QPOS", "QVEL", "QACC")]


class Part:
    """Base of the parts that drive joints of the world."""

    def bind(self, world: World) -> None:
        """Takes model and state of the world, new after a change of the scene; robot joints keep their values."""
        raise NotImplementedError

    def before_step(self) -> None:
        """Writes the efforts of its joints for the next step."""

    def after_step(self) -> None:
        """Reads the result of the step."""


@dataclasses.dataclass(frozen=True)
class ObjectState:
    """State of an object."""

    position: tuple[float, ...]  # of its middle in the world, shape (3,) [m]
    quaternion: tuple[float, ...]  # x, y, z, w
    speed: float  # of its middle [m/s]
    clearance: float  # height of its lowest point above the table top [m]
    touches: tuple[str, ...]  # sorted names of the bodies in contact


class World:
    """The world; `seed`: of the poses of scattered objects. `model` and `data`, of MuJoCo, are new after a change of
    the scene. Raises ConfigError if the scene or the marker board is invalid, FileNotFoundError if there is no
    description of this robot."""

    def __init__(self, description: WorldDescription, seed: int = 0) -> None:
        self._parts: list[Part] = []
        self._rng = np.random.default_rng(seed)
        self.steps = self.loads = 0  # steps, and models, since the start; rebuild a copy when `loads` changes
        self._load(description)

    @property
    def timestep(self) -> float:
        """Length of a step [s]."""
        return TIMESTEP_S

    @property
    def time(self) -> float:
        """Time since the start [s]."""
        return self.steps * self.timestep

    def add(self, part: Part) -> None:
        """Adds a part; parts act in the order of their addition."""
        self._parts.append(part)
        part.bind(self)
        mujoco.mj_forward(self.model, self.data)

    def step(self, count: int = 1) -> None:
        """Advances by so many time steps in one; raises DeviceError if the physics diverged: the state is unusable
        then."""
        self.model.opt.timestep = count * TIMESTEP_S
        mujoco.mj_step1(self.model, self.data)
        for part in self._parts:
            part.before_step()
        mujoco.mj_step2(self.model, self.data)
        q_bad, v_bad, a_bad = self._diverged
        if q_bad.number or v_bad.number or a_bad.number:
            raise DeviceError(f"The physics diverged after {self.time:.3f} s. Reset it; check the masses in the scene.")
        self.steps += count
        for part in self._parts:
            part.after_step()

    def reset(self) -> None:
        """Puts all objects back to their poses of the scene, at rest; arm and hand keep their state. Raises ValueError,
        with nothing changed, if the robot is in the way of an object."""
        placed = self._placed(self.model, self._scene, self.data)
        self.data.qpos[:] = placed.qpos
        self.data.qvel[:] = placed.qvel
        self.data.qacc_warmstart[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def set_scene(self, values: Mapping[str, Any]) -> None:
        """Changes the scene to a mapping as in a scene's yaml; arm and hand keep their state. Raises ConfigError for an
        invalid scene, ValueError if the robot is in its way; nothing has changed then."""
        self._load(dataclasses.replace(self.description, scene=values))
        for part in self._parts:
            part.bind(self)
        mujoco.mj_forward(self.model, self.data)

    def objects(self) -> dict[str, ObjectState]:
        pairs = _pairs(self.data, self._geom_bodies)
        touches: dict[str, set[str]] = {name: set() for name in self._scene.objects}
        for one, other in pairs + [pair[::-1] for pair in pairs]:
            if one.startswith("object/"):
                touches[one[7:]].add(other)
        return {name: self._object(name, touches[name]) for name in self._scene.objects}

    def contacts(self) -> list[dict[str, Any]]:
        """Returns all contacts with a force, as the control port answers them: the names of both bodies, position [m],
        normal from the first to the second, the force along it [N], and the depth of penetration [m]."""
        found = []
        force = np.zeros(6)
        for i, bodies in enumerate(_pairs(self.data, self._geom_bodies)):
            mujoco.mj_contactForce(self.model, self.data, i, force)
            if force[0] > 0.0:
                contact = self.data.contact[i]
                place = {"position": contact.pos.tolist(), "normal": contact.frame[:3].tolist()}
                found.append({"bodies": bodies, **place, "force": float(force[0]), "depth": float(-contact.dist)})
        return found

    def _build(self, description: WorldDescription) -> mujoco.MjModel:
        return build_model(description, visuals=False)

    def _load(self, description: WorldDescription) -> None:
        model, scene = self._build(description), scene_from(description.scene)
        self.data: mujoco.MjData = self._placed(model, scene, self.data if self.loads else None)
        self.model, self.description, self._scene = model, description, scene
        self._geom_bodies = _geom_bodies(model)
        self._diverged = [self.data.warning[number] for number in DIVERGED]
        self.loads += 1

    def _placed(self, model: mujoco.MjModel, scene: WorldScene, before: mujoco.MjData | None) -> mujoco.MjData:
        """Returns a state with the robot as in `before` and the objects as in the scene."""
        placements = 200
        free_qpos = 7
        free_qvel = 6
        data = mujoco.MjData(model)
        count = len(scene.objects)
        robot_qpos, robot_qvel = model.nq - free_qpos * count, model.nv - free_qvel * count
        if before is not None:
            data.qpos[:robot_qpos] = before.qpos[:robot_qpos]
            data.qvel[:robot_qvel] = before.qvel[:robot_qvel]
        for _ in range(placements if scene.scatter else 1):
            for i, shape in enumerate(scene.objects.values()):
                start = robot_qpos + free_qpos * i
                data.qpos[start : start + free_qpos] = self._place(scene, shape)
            mujoco.mj_forward(model, data)
            overlap = _overlap(model, data)
            if overlap is None:
                return data
            one, other = overlap
        raise ValueError(f"There is no room: {one} would be in {other}. Change its pose, or move the arm home first.")

    def _place(self, scene: WorldScene, shape: SceneObject) -> np.ndarray:
        drop_m = 0.0008  # height above the table at which objects start; they settle on it
        shift, turn = np.zeros(2), 0.0
        if scene.scatter:
            shift, turn = self._rng.uniform(-scene.scatter, scene.scatter, 2), self._rng.uniform(-np.pi, np.pi)
        middle = (*(shape.position + shift), shape.height / 2.0 + drop_m)
        T = table_pose(scene.table) @ pose(rotation_about(2, np.radians(shape.yaw) + turn), middle)
        return np.concatenate([T[:3, 3], quaternion_from_rotation(T[:3, :3])[[3, 0, 1, 2]]])

    def _object(self, name: str, touches: set[str]) -> ObjectState:
        joint = self.data.joint(f"object/{name}")
        body = self.model.body(f"object/{name}").id
        w, x, y, z = joint.qpos[3:].tolist()
        clearance = lowest_point(self.model, self.data, body) - self._scene.table.top
        speed = float(np.linalg.norm(joint.qvel[:3]))
        return ObjectState(tuple(joint.qpos[:3].tolist()), (x, y, z, w), speed, clearance, tuple(sorted(touches)))


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> float:
    """Returns the height of the lowest point of an object made of boxes, cylinders and balls, in the world [m]."""
    geoms = slice(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    down, size, kind = np.abs(data.geom_xmat[geoms, 6:]), model.geom_size[geoms], model.geom_type[geoms]
    of_box = np.sum(down * size, axis=1)
    of_cylinder = down[:, 2] * size[:, 1] + np.hypot(down[:, 0], down[:, 1]) * size[:, 0]
    kinds = [kind == mujoco.mjtGeom.mjGEOM_BOX, kind == mujoco.mjtGeom.mjGEOM_CYLINDER]
    reach = np.select(kinds, [of_box, of_cylinder], size[:, 0])
    return float(np.min(data.geom_xpos[geoms, 2] - reach))


def _geom_bodies(model: mujoco.MjModel) -> list[str]:
    return [model.body(body).name for body in model.geom_bodyid]


def _pairs(data: mujoco.MjData, geom_bodies: list[str]) -> list[tuple[str, str]]:
    return [(geom_bodies[one], geom_bodies[other]) for one, other in data.contact.geom.tolist()]


def _overlap(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[str, str] | None:
    """Returns the names of two bodies that penetrate each other, or None; the robot's own parts may."""
    deepest_touch_m = 0.001
    for (one, other), distance in zip(_pairs(data, _geom_bodies(model)), data.contact.dist):
        if distance < -deepest_touch_m and not (ROBOT.match(one) and ROBOT.match(other)):
            return (one, other) if not ROBOT.match(one) else (other, one)
    return None
