"""Grasps of a parallel gripper in six degrees of freedom: opposed points of an object's surface, and where the open
hand meets nothing on its way. Whether they hold says the physics (`evaluation.lifting`).

A pose is that of `lifting.lift`: z is the approach, x through both fingers; the tips are `Gripper.reach` further along
z. Lengths in metres, angles in rad.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from common.poses import pose
from common.rotations import quaternion_from_rotation
from grasping.lab.evaluation.lifting import FINGER_M
from grasping.lab.synthetic.scene import HeapScene, world_xml, xml_text
from grasping.poses.gripper import Gripper

DEPTHS_M = (0.003, 0.010, 0.020)  # of the tips beyond the line through both contacts
DOWN = np.array([0.0, 0.0, -1.0])

PART = '<body name="{name}" pos="0 0 {high}"><freejoint/><geom type="box" size="{size}"/></body>'


class FullPose(NamedTuple):
    """A grasp in the world."""

    T_world_grasp: np.ndarray  # shape (4, 4) [m]
    opening: float  # between the pads before they close [m]
    steep: float  # greatest angle between a contact's normal and the line through both [rad]

    @property
    def tilt(self) -> float:
        """Angle between the approach and straight down [rad]."""
        return float(np.arccos(np.clip(self.T_world_grasp[:3, 2] @ DOWN, -1.0, 1.0)))


class _Contact(NamedTuple):
    point: np.ndarray  # shape (3,) [m]
    normal: np.ndarray  # outwards, shape (3,)


class PoseSampler:
    """Samples grasps of the objects of one scene."""

    def __init__(self, scene: HeapScene, gripper: Gripper) -> None:
        self._gripper = gripper
        self._model = mujoco.MjModel.from_xml_string(world_xml(scene.objects, bodies=_hand(gripper), fixed=scene.fixed))
        self._data = mujoco.MjData(self._model)
        self._data.qpos[: len(scene.state)] = scene.state
        self._hand = self._data.qpos[len(scene.state) :].reshape(-1, 7)
        self._alone = [_Alone(scene, i) for i in range(len(scene.objects))]
        hand = {self._model.body(name).id for name in ("palm", "finger0", "finger1")}
        self._hand_geoms = [g for g in range(self._model.ngeom) if self._model.geom_bodyid[g] in hand]

    def free(self, rng: np.random.Generator, target: int, tries: int, max_tilt: float) -> Iterator[FullPose]:
        """Yields grasps of an object to which the hand comes without a touch, of `tries` random lines through it."""
        for _ in range(tries):
            for candidate in self._of_line(rng, target, max_tilt):
                if not self.touches(candidate):
                    yield candidate
                    break

    def _of_line(self, rng: np.random.Generator, target: int, max_tilt: float) -> list[FullPose]:
        gripper, friction_rad = self._gripper, np.arctan(self._gripper.friction)
        found = self._alone[target].contacts(rng, friction_rad)
        if found is None:
            return []
        left, right = found
        between = right.point - left.point
        width = float(np.linalg.norm(between))
        across = between / max(width, 1e-9)
        opening = min(width + 2.0 * gripper.clearance + rng.uniform(0.0, 0.012), gripper.opening)
        steep = float(np.arccos(np.clip(min(-left.normal @ across, right.normal @ across), -1.0, 1.0)))
        too_wide = width + 2.0 * gripper.clearance > gripper.opening
        if too_wide or steep > friction_rad or abs(across[2]) > np.sin(max_tilt):
            return []
        middle = 0.5 * (left.point + right.point)
        straight = DOWN - (DOWN @ across) * across
        straight /= np.linalg.norm(straight)
        aside = np.cross(across, straight)
        poses = []
        for turn in rng.permutation(np.concatenate([[0.0], rng.uniform(-max_tilt, max_tilt, 2)])):
            approach = np.cos(turn) * straight + np.sin(turn) * aside
            if approach @ DOWN < np.cos(max_tilt):
                continue
            R = np.column_stack([across, np.cross(approach, across), approach])
            for depth in rng.permutation(DEPTHS_M):
                poses.append(FullPose(pose(R, middle + (depth - gripper.reach) * approach), opening, steep))
        return poses

    def touches(self, candidate: FullPose) -> bool:
        """Whether the open hand touches anything at the grasp or on its way there."""
        T, gripper = candidate.T_world_grasp, self._gripper
        half = 0.5 * (max(candidate.opening, gripper.least) + gripper.thickness)
        approach = T[:3, 2]
        for back in (0.0, 0.03, 0.08):
            tips = T[:3, 3] + (gripper.reach - back) * approach
            places = (
                tips - (FINGER_M + 0.01) * approach,
                *(tips - 0.5 * FINGER_M * approach + side * half * T[:3, 0] for side in (-1.0, 1.0)),
            )
            quaternion = quaternion_from_rotation(T[:3, :3])[[3, 0, 1, 2]]
            for part, place in zip(self._hand, places):
                part[:3], part[3:] = place, quaternion
            mujoco.mj_kinematics(self._model, self._data)
            mujoco.mj_collision(self._model, self._data)
            # Palm and fingers meet one another, too.
            if (np.isin(self._data.contact.geom, self._hand_geoms).sum(axis=1) == 1).any():
                return True
        return False


class _Alone:
    """One object of a scene alone, for rays."""

    def __init__(self, scene: HeapScene, number: int) -> None:
        self._model = mujoco.MjModel.from_xml_string(world_xml((scene.objects[number],)))
        self._model.geom_group[0] = 1  # the table, which rays shall not meet
        self._group = np.array([1, 0, 0, 0, 0, 0], np.uint8)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = scene.state[7 * number : 7 * number + 7]
        mujoco.mj_kinematics(self._model, self._data)
        centres, radii = self._data.geom_xpos[1:], self._model.geom_rbound[1:]
        self._low = (centres - radii[:, None]).min(axis=0)
        self._high = (centres + radii[:, None]).max(axis=0)

    def contacts(self, rng: np.random.Generator, cone: float) -> tuple[_Contact, _Contact] | None:
        """Returns a random point of the surface, and where a random line within `cone` [rad] of its normal leaves the
        object; None where the surface is not smooth."""
        first = self._contact(rng.uniform(self._low, self._high), _random_unit(rng))
        if first is None:
            return None
        across = -first.normal + np.tan(cone) * rng.uniform(0.0, 0.7) * _random_unit(rng)
        across /= np.linalg.norm(across)
        left, right = self._contact(first.point, across), self._contact(first.point, -across)
        return None if left is None or right is None else (left, right)

    def _contact(self, through: np.ndarray, along: np.ndarray) -> _Contact | None:
        """Returns the first point that a ray through a point meets, from far away, with the plane of its neighbours."""
        away_m, step_m, jump_m = 0.4, 0.0015, 0.004
        u = np.cross(along, (0.0, 0.0, 1.0) if abs(along[2]) < 0.9 else (1.0, 0.0, 0.0))
        u /= np.linalg.norm(u)
        v = np.cross(along, u)
        geom = np.zeros(1, np.int32)
        depths = []
        for a, b in ((0.0, 0.0), (-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0)):
            start = through - away_m * along + step_m * (a * u + b * v)
            depths.append(mujoco.mj_ray(self._model, self._data, start, along, self._group, 1, -1, geom))
        if min(depths) < 0.0 or max(depths) - min(depths) > jump_m:
            return None
        slope_u, slope_v = (depths[2] - depths[1]) / (2.0 * step_m), (depths[4] - depths[3]) / (2.0 * step_m)
        normal = -along + slope_u * u + slope_v * v
        return _Contact(through + (depths[0] - away_m) * along, normal / np.linalg.norm(normal))


def _random_unit(rng: np.random.Generator) -> np.ndarray:
    direction = rng.standard_normal(3)
    return direction / np.linalg.norm(direction)


def _hand(gripper: Gripper) -> str:
    """Returns palm and two fingers, each to be placed by itself."""
    palm = 0.5 * gripper.opening + gripper.thickness, 0.75 * gripper.breadth, 0.01
    finger = 0.5 * gripper.thickness, 0.5 * gripper.breadth, 0.5 * FINGER_M
    sizes = {"palm": palm, "finger0": finger, "finger1": finger}
    # Bodies with joints: MuJoCo finds no contacts between what stands fast and the table.
    parts = enumerate(sizes.items(), start=3)
    return "".join(PART.format(name=name, high=high, size=xml_text(size)) for high, (name, size) in parts)
