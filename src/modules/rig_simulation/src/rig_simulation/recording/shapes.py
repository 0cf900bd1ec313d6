"""Table and objects of the world as plain shapes, for programs without MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from common.frames import BASE
from common.poses import inverse, pose, read_only

BOX, BALL, CYLINDER = "box", "ball", "cylinder"
_KINDS = {
    mujoco.mjtGeom.mjGEOM_BOX: BOX,
    mujoco.mjtGeom.mjGEOM_SPHERE: BALL,
    mujoco.mjtGeom.mjGEOM_CYLINDER: CYLINDER,
}
SMALLEST_M = 0.004
"""Smaller balls, the feet of objects, are not shown."""


@dataclass(frozen=True)
class Shape:
    """A part of a body."""

    body: str  # such as table or object/cup
    kind: str  # BOX, BALL or CYLINDER; a cylinder's axis is its z
    size: np.ndarray  # extents along its own axes, shape (3,) [m]
    T_base_shape: np.ndarray  # pose in kuka/base_frame, shape (4, 4)
    colour: tuple[float, ...]  # red, green, blue, alpha, 0..1.


def beyond(parts: Sequence[Shape], towards: np.ndarray, clearance: float) -> np.ndarray:
    """Returns the point from the middle of a body in a direction, `clearance` [m] beyond its farthest point.

    Args:
        parts: all shapes of the body.
        towards: unit vector in kuka/base_frame, shape (3,).
    """
    middle = np.mean([part.T_base_shape[:3, 3] for part in parts], axis=0)
    ends = [
        towards @ part.T_base_shape[:3, 3] + np.abs(towards @ part.T_base_shape[:3, :3]) @ part.size / 2.0
        for part in parts
    ]
    return middle + (max(ends) - towards @ middle + clearance) * towards


def base_pose(data: mujoco.MjData) -> np.ndarray:
    """Returns the pose of kuka/base_frame in the world, shape (4, 4)."""
    body = data.body(BASE)
    return pose(body.xmat.reshape(3, 3), body.xpos)


def shapes(model: mujoco.MjModel, data: mujoco.MjData) -> list[Shape]:
    """Returns the shapes of the table and of all objects.

    Args:
        model: the world's.
        data: with computed kinematics.
    """
    T_base_world = inverse(base_pose(data))
    found = []
    for geom in range(model.ngeom):
        body = model.body(model.geom_bodyid[geom]).name
        kind = _KINDS.get(model.geom_type[geom])
        if kind is None or not (body == "table" or body.startswith("object/")):
            continue
        half = model.geom_size[geom]
        if kind == BALL and half[0] < SMALLEST_M:
            continue
        extents = {BOX: half, BALL: half[[0, 0, 0]], CYLINDER: half[[0, 0, 1]]}[kind]
        T_world_shape = pose(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        colour = tuple(model.geom_rgba[geom].tolist())
        found.append(Shape(body, kind, read_only(2.0 * extents), read_only(T_base_world @ T_world_shape), colour))
    return found
