"""Where objects lie that are not easily grasped from above: in a box, against a wall, on a slope, on one another.

Objects settle with the least friction with which they are lifted later, so that none starts to slide then. Lengths in
metres, angles in rad.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np

from grasping.lab.synthetic import shapes
from grasping.lab.synthetic.scene import Family, HeapScene, world_xml
from grasping.lab.synthetic.shapes import Geom

BOX, WALL, SLOPE, STACK = "in_box", "at_wall", "on_slope", "stacked"
KINDS = (BOX, WALL, SLOPE, STACK)
FRICTION = 0.35


class Surroundings(NamedTuple):
    """What stands fast around the objects, and how they come to lie there."""

    fixed: shapes.Shape
    places: np.ndarray  # where each object is dropped, shape (n, 3) [m]
    pull: np.ndarray  # what pulls the objects sideways at first, shape (3,), in units of gravity


def hard_scene(rng: np.random.Generator, kind: str, families: tuple[Family, ...]) -> HeapScene | None:
    """Returns a settled scene of one of the `KINDS`, or None when its objects do not lie still where they should."""
    pulled_s, settle_s, limit_m = 1.0, 2.0, 0.16
    count = {BOX: 3, WALL: 2, SLOPE: 1, STACK: 2}[kind]
    chosen = [families[i] for i in rng.integers(0, len(families), count)]
    objects = [family(rng) for family in chosen]
    names = [family.__name__ for family in chosen]
    if kind == STACK:
        objects[0], names[0] = _slab(rng), "slab"
    around = _around(rng, kind, count)
    xml = world_xml(objects, FRICTION, fixed=around.fixed)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    state = data.qpos.reshape(count, 7)
    for i in range(count):
        state[i] = *around.places[i], *shapes.random_quaternion(rng)
    if kind == STACK:
        state[0, 3:] = shapes.UPRIGHT
    down = model.opt.gravity.copy()
    model.opt.gravity[:] = down + around.pull * np.linalg.norm(down)
    mujoco.mj_step(model, data, nstep=int(pulled_s / model.opt.timestep))
    model.opt.gravity[:] = down
    mujoco.mj_step(model, data, nstep=int(settle_s / model.opt.timestep))
    far = np.linalg.norm(state[:, :2], axis=1).max() > limit_m or state[:, 2].min() < 0.0
    still = np.abs(data.qvel).max() < 0.05 and not data.warning.number.any()
    if far or not still or not _as_meant(model, data, kind, count):
        return None
    return HeapScene(xml, data.qpos.copy(), tuple(objects), tuple(names), around.fixed)


def _around(rng: np.random.Generator, kind: str, count: int) -> Surroundings:
    heights = 0.07 + 0.08 * np.arange(count)
    spread = 0.04 if count > 1 else 0.02
    places = np.column_stack([rng.uniform(-spread, spread, (count, 2)), heights])
    turn = rng.uniform(-np.pi, np.pi)
    if kind == BOX:
        return Surroundings(_walls(rng, turn), places, np.zeros(3))
    if kind == WALL:
        away, half_height = 0.06, rng.uniform(0.03, 0.07)
        wall = _turned_box((0.004, 0.16, half_height), (away, 0.0, half_height), turn)
        return Surroundings((wall,), places, np.array([np.cos(turn), np.sin(turn), 0.0]) * 0.6)
    if kind == SLOPE:
        tilt = rng.uniform(0.14, 0.3)
        half = 0.5 * tilt
        lean = np.array([np.cos(half), -np.sin(half) * np.sin(turn), np.sin(half) * np.cos(turn), 0.0])
        plate = Geom("box", (0.14, 0.14, 0.004), (0.0, 0.0, 0.14 * np.sin(tilt) + 0.004), tuple(lean.tolist()))
        places[:, 2] += 0.14 * np.sin(tilt)
        return Surroundings((plate,), places, np.zeros(3))
    places[:, 2] = 0.035, 0.11
    return Surroundings((), places, np.zeros(3))


def _walls(rng: np.random.Generator, turn: float) -> shapes.Shape:
    """Returns four walls of a box without a lid."""
    x, y, half_height, half = rng.uniform(0.1, 0.13), rng.uniform(0.08, 0.11), rng.uniform(0.025, 0.05), 0.004
    sides = [((half, y + 2.0 * half, half_height), (side * (x + half), 0.0, half_height)) for side in (-1.0, 1.0)]
    sides += [((x, half, half_height), (0.0, side * (y + half), half_height)) for side in (-1.0, 1.0)]
    return tuple(_turned_box(size, place, turn) for size, place in sides)


def _turned_box(size: tuple[float, float, float], place: tuple[float, float, float], turn: float) -> Geom:
    """Returns a box that is turned about the world's z axis with its place."""
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = place
    quaternion = (float(np.cos(0.5 * turn)), 0.0, 0.0, float(np.sin(0.5 * turn)))
    return Geom("box", size, (float(c * x - s * y), float(s * x + c * y), z), quaternion)


def _slab(rng: np.random.Generator) -> shapes.Shape:
    return (Geom("box", (*rng.uniform(0.04, 0.07, 2).tolist(), rng.uniform(0.008, 0.025))),)


def _as_meant(model: mujoco.MjModel, data: mujoco.MjData, kind: str, count: int) -> bool:
    """Returns whether the objects lie as the kind says: one leans on the wall, one lies on the slab alone, one on the
    slope; in the box all do."""
    fixed = {geom for geom in range(1, model.ngeom) if model.geom_bodyid[geom] == 0}
    first = model.body("object0").id
    touched: list[set[int]] = [set() for _ in range(count)]
    on: list[set[int]] = [set() for _ in range(count)]
    for a, b in data.contact.geom:
        for one, other in ((a, b), (b, a)):
            if model.geom_bodyid[one] >= first:
                touched[model.geom_bodyid[one] - first].add(int(other))
                on[model.geom_bodyid[one] - first].add(int(model.geom_bodyid[other]))
    if kind == WALL:
        return any(found & fixed for found in touched)
    if kind == SLOPE:
        return bool(touched[0] & fixed) and 0 not in touched[0]
    if kind == STACK:
        return on[1] == {first}
    return True
