"""The table and the objects on it as bodies of the physics: contact shapes, masses, friction."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from common.poses import pose
from common.rotations import rotation_about
from rig_simulation.world.mjcf import BOARD, OBJECT, body, geom
from rig_simulation.world.scene import Ball, Bottle, Cuboid, Cup, Cylinder, SceneObject, Table

TABLE_THICKNESS = 0.03
WALL_PLATES = 16
FEET = 8
FOOT_RADIUS = 0.0025
FOOT_OUT = 0.0005
"""A round bottom stands on small balls: a cylinder on a box has few, unsteady contact points."""
BOTTOM_FRACTION = 0.25
"""Fraction of a cup's mass in its bottom."""


def table_pose(table: Table) -> np.ndarray:
    """Returns the pose of the middle of the table top in the world, shape (4, 4)."""
    return pose(rotation_about(2, np.radians(table.yaw)), (*table.centre, table.top))


def add_table(world: ET.Element, table: Table) -> None:
    """Adds the board of the table to the world."""
    board = body(world, "table", table_pose(table))
    half = (*(table.size / 2.0), TABLE_THICKNESS / 2.0)
    geom(board, "table", BOARD, "box", half, p=(0, 0, -TABLE_THICKNESS / 2.0), friction=table.friction)


def add_object(world: ET.Element, name: str, shape: SceneObject) -> None:
    """Adds a free object; a reset sets its pose."""
    element = body(world, f"object/{name}", np.eye(4))
    ET.SubElement(element, "freejoint", name=f"object/{name}")
    look: dict[str, Any] = {"friction": shape.friction, "colour": shape.colour}
    prefix = f"object/{name}"
    if isinstance(shape, Cuboid):
        geom(element, f"{prefix}/box", OBJECT, "box", shape.size / 2.0, mass=shape.mass, **look)
    elif isinstance(shape, Ball):
        geom(element, f"{prefix}/ball", OBJECT, "sphere", [shape.radius], mass=shape.mass, **look)
    elif isinstance(shape, Cup):
        _cup(element, prefix, shape, look)
    elif isinstance(shape, Cylinder):
        size = (shape.radius, shape.height / 2.0)
        geom(element, f"{prefix}/body", OBJECT, "cylinder", size, mass=shape.mass, **look)
        _feet(element, prefix, shape.radius, shape.height, look)
    elif isinstance(shape, Bottle):
        _bottle(element, prefix, shape, look)
    else:
        raise TypeError(f"There is no shape for {type(shape).__name__}.")


def _cup(element: ET.Element, prefix: str, cup: Cup, look: dict[str, Any]) -> None:
    bottom = (cup.radius, cup.wall / 2.0)
    below = (0, 0, cup.wall / 2.0 - cup.height / 2.0)
    geom(element, f"{prefix}/bottom", OBJECT, "cylinder", bottom, p=below, mass=BOTTOM_FRACTION * cup.mass, **look)
    mass = (1.0 - BOTTOM_FRACTION) * cup.mass / WALL_PLATES
    half_width = cup.radius * np.tan(np.pi / WALL_PLATES)
    half_height = (cup.height - cup.wall) / 2.0
    for i in range(WALL_PLATES):
        R = rotation_about(2, 2.0 * np.pi * i / WALL_PLATES)
        middle = R @ np.array([cup.radius - cup.wall / 2.0, 0.0, cup.wall / 2.0])
        half = (cup.wall / 2.0, half_width, half_height)
        geom(element, f"{prefix}/wall_{i}", OBJECT, "box", half, p=middle, R=R, mass=mass, **look)
    _feet(element, prefix, cup.radius, cup.height, look)


def _bottle(element: ET.Element, prefix: str, bottle: Bottle, look: dict[str, Any]) -> None:
    low, high = bottle.height - bottle.neck_height, bottle.neck_height
    volumes = np.array([bottle.radius**2 * low, bottle.neck_radius**2 * high])
    masses = bottle.mass * volumes / volumes.sum()
    below, above = (0, 0, (low - bottle.height) / 2.0), (0, 0, (bottle.height - high) / 2.0)
    body_size, neck_size = (bottle.radius, low / 2.0), (bottle.neck_radius, high / 2.0)
    geom(element, f"{prefix}/body", OBJECT, "cylinder", body_size, p=below, mass=masses[0], **look)
    geom(element, f"{prefix}/neck", OBJECT, "cylinder", neck_size, p=above, mass=masses[1], **look)
    _feet(element, prefix, bottle.radius, bottle.height, look)


def _feet(element: ET.Element, prefix: str, radius: float, height: float, look: dict[str, Any]) -> None:
    for i in range(FEET):
        angle = 2.0 * np.pi * (i + 0.5) / FEET
        across = radius - FOOT_RADIUS
        middle = (across * np.cos(angle), across * np.sin(angle), FOOT_RADIUS - FOOT_OUT - height / 2.0)
        geom(element, f"{prefix}/foot_{i}", OBJECT, "sphere", [FOOT_RADIUS], p=middle, mass=1e-6, **look)
