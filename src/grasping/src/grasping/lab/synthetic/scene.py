"""Heaps of random objects on a table, settled by MuJoCo, and what a depth camera above sees of them.

The world's z points up and the table's top is z = 0. The camera's axes are those of an image: x right, y down, z
forward. Depths are distances along the optical axis [m].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Callable, NamedTuple

import mujoco
import numpy as np

from grasping.lab.synthetic import shapes

Family = Callable[[np.random.Generator], shapes.Shape]
FAR_M = 100.0  # distance of the eye for a parallel view: 0.1 m of height shift a point by 0.1 % of its offset
DOWN_TO_X = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
DENSITY = 350.0  # of the objects [kg/m^3]

WORLD = """<mujoco><compiler angle="radian"/>
<option timestep="0.004" integrator="implicitfast" cone="elliptic" noslip_iterations="{noslip}"/>
<size memory="64M"/>
<default><geom condim="6" friction="{friction} 0.005 0.002" solref="0.006 1"/></default>
<asset>{assets}</asset>
<worldbody><geom name="table" type="plane" size="2 2 0.1"/>{bodies}</worldbody>{rest}</mujoco>"""


class SceneCamera(NamedTuple):
    """A depth camera above the table."""

    position: np.ndarray  # of the optical centre in the world, shape (3,) [m]
    R: np.ndarray  # orientation of the camera's axes in the world, shape (3, 3)
    focal: float  # focal length [px]
    side: int  # rows and columns of its square image [px]


class HeapScene(NamedTuple):
    """A settled scene."""

    xml: str  # the model
    state: np.ndarray  # positions of all joints, as MuJoCo counts them
    objects: tuple[shapes.Shape, ...]  # the shapes in the order of the bodies `object0`, `object1`, ..
    families: tuple[str, ...]  # their names
    fixed: shapes.Shape = ()  # what stands fast beside them, in the world


def world_xml(
    objects: Iterable[shapes.Shape],
    friction: float = 0.6,
    noslip: int = 0,
    bodies: str = "",
    rest: str = "",
    fixed: shapes.Shape = (),
) -> str:
    """Returns the model of a table with `objects`, each with a free joint, what stands fast, and what else is given as
    XML."""
    assets: list[str] = []
    xml = [_geoms_xml(fixed, "fixed", assets)]
    for i, shape in enumerate(objects):
        xml.append(f'<body name="object{i}"><freejoint/>{_geoms_xml(shape, f"mesh{i}", assets)}</body>')
    return WORLD.format(
        assets="".join(assets), bodies="".join(xml) + bodies, friction=friction, noslip=noslip, rest=rest
    )


def _geoms_xml(shape: shapes.Shape, name: str, assets: list[str]) -> str:
    geoms = []
    for j, geom in enumerate(shape):
        attributes = f'type="{geom.kind}" size="{xml_text(geom.size)}"'
        if geom.kind == "mesh":
            assets.append(f'<mesh name="{name}_{j}" vertex="{xml_text(np.ravel(geom.vertices))}"/>')
            attributes = f'type="mesh" mesh="{name}_{j}"'
        place = f'pos="{xml_text(geom.position)}" quat="{xml_text(geom.quaternion)}"'
        geoms.append(f'<geom {attributes} {place} density="{DENSITY}"/>')
    return "".join(geoms)


def settled_scene(rng: np.random.Generator, families: Sequence[Family], count: int) -> HeapScene | None:
    """Returns `count` objects that were dropped on the table, or None when they ran away or do not lie still."""
    settle_s = 2.0
    max_radius_m = 0.13  # scenes with an object beyond this distance from the camera's axis are thrown away
    max_speed = 0.05
    max_turning = 1.0  # fastest object of a scene that counts as settled [m/s and rad/s]; an egg rocks for long
    chosen = [families[i] for i in rng.integers(0, len(families), count)]
    objects = tuple(family(rng) for family in chosen)
    xml = world_xml(objects)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    for i in range(count):
        spread = 0.02 if count == 1 else 0.06
        place = [*rng.uniform(-spread, spread, 2), 0.07 + 0.08 * i]
        data.qpos[7 * i : 7 * i + 7] = [*place, *shapes.random_quaternion(rng)]
    mujoco.mj_step(model, data, nstep=int(settle_s / model.opt.timestep))
    places = data.qpos.reshape(count, 7)[:, :3]
    speeds = np.abs(data.qvel).reshape(count, 2, 3).max(axis=(0, 2))
    still = speeds[0] < max_speed and speeds[1] < max_turning and not data.warning.number.any()
    if not still or np.linalg.norm(places[:, :2], axis=1).max() > max_radius_m or places[:, 2].min() < 0.0:
        return None
    return HeapScene(xml, data.qpos.copy(), objects, tuple(f.__name__ for f in chosen))


def random_camera(rng: np.random.Generator, focal: float, side: int, max_tilt: float) -> SceneCamera:
    """Returns a camera 0.55 to 0.85 m above the table that looks almost straight down near its middle."""
    turn, away, tilt = *rng.uniform(-np.pi, np.pi, 2), rng.uniform(0.0, max_tilt)
    down = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    axis = np.array([np.cos(away), np.sin(away), 0.0])
    quaternion, tilted = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, axis, tilt)
    mujoco.mju_quat2Mat(tilted, quaternion)
    c, s = np.cos(turn), np.sin(turn)
    R = tilted.reshape(3, 3) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ down
    target = np.array([*rng.uniform(-0.03, 0.03, 2), 0.0])
    return SceneCamera(target - rng.uniform(0.55, 0.85) * R[:, 2], R, focal, side)


def straight_above(camera: SceneCamera) -> SceneCamera:
    """Returns the camera as it would look straight down on the same point of the table, turned as little as it can."""
    z, x = np.array([0.0, 0.0, -1.0]), camera.R[:, 0] * (1.0, 1.0, 0.0)
    x = x / np.linalg.norm(x)
    target = camera.position - camera.position[2] / camera.R[2, 2] * camera.R[:, 2]
    position = np.array([target[0], target[1], camera.position[2]])
    return SceneCamera(position, np.column_stack([x, np.cross(z, x), z]), camera.focal, camera.side)


def rays(camera: SceneCamera) -> np.ndarray:
    """Returns the viewing direction of each pixel in the camera's axes with z = 1, shape (side * side, 3)."""
    c = (np.arange(camera.side) - 0.5 * (camera.side - 1)) / camera.focal
    x, y = np.meshgrid(c, c)
    return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)


def points(depth: np.ndarray, camera: SceneCamera) -> np.ndarray:
    """Returns where the pixels of a square depth image, shape (h, w) [m], lie in the world, shape (h, w, 3) [m]."""
    scaled = camera._replace(focal=camera.focal * len(depth) / camera.side, side=len(depth))
    return camera.position + (depth[..., None] * rays(scaled).reshape(*depth.shape, 3)) @ camera.R.T


def depth_image(model: mujoco.MjModel, data: mujoco.MjData, camera: SceneCamera) -> np.ndarray:
    """Returns the exact depth of each pixel, shape (side, side) [m]."""
    return _cast(model, data, camera.position, rays(camera) @ camera.R.T, camera.side)


def height_map(model: mujoco.MjModel, data: mujoco.MjData, camera: SceneCamera, cell: float, side: int) -> np.ndarray:
    """Returns the depth below the camera in a parallel view along its axis, shape (side, side) [m]; `camera`: gives the
    axes; the map's middle is the optical axis; `cell`: width of a cell [m].
    """
    eye = SceneCamera(camera.position - FAR_M * camera.R[:, 2], camera.R, FAR_M / cell, side)
    return _cast(model, data, eye.position, rays(eye) @ camera.R.T, side) - FAR_M


def table_depth(camera: SceneCamera, cell: float, side: int) -> np.ndarray:
    """Returns the depth of the bare table in the same parallel view, shape (side, side) [m]."""
    c = cell * (np.arange(side) - 0.5 * (side - 1))
    x, y = np.meshgrid(c, c)
    return -(camera.position[2] + camera.R[2, 0] * x + camera.R[2, 1] * y) / camera.R[2, 2]


def _cast(
    model: mujoco.MjModel, data: mujoco.MjData, origin: np.ndarray, directions: np.ndarray, side: int
) -> np.ndarray:
    """Returns how many times its direction each ray goes until it meets something, shape (side, side). MuJoCo 3.2 loses
    some objects straight above and below the eye, so a copy of the world is turned until down is x.
    """
    turned = mujoco.MjData(model)
    turned.qpos[:] = data.qpos
    mujoco.mj_kinematics(model, turned)
    for name in ("xpos", "xipos", "geom_xpos"):
        getattr(turned, name)[:] = getattr(turned, name) @ DOWN_TO_X.T
    for name in ("xmat", "ximat", "geom_xmat"):
        matrices = getattr(turned, name)
        matrices[:] = (DOWN_TO_X @ matrices.reshape(-1, 3, 3)).reshape(matrices.shape)
    n = len(directions)
    lengths = np.linalg.norm(directions, axis=1)
    units = (directions / lengths[:, None]) @ DOWN_TO_X.T
    distance, geom = np.zeros(n), np.zeros(n, dtype=np.int32)
    mujoco.mj_multiRay(model, turned, DOWN_TO_X @ origin, np.ravel(units), None, 1, -1, geom, distance, n, 10.0 * FAR_M)
    return (distance / lengths).reshape(side, side)


def xml_text(values: Iterable[float]) -> str:
    """Returns numbers as an attribute of MuJoCo's XML."""
    return " ".join(f"{v:.6g}" for v in values)
