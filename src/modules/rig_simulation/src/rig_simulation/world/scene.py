"""The content of the simulated world besides the rig: schema and records of a scene's yaml, and its bodies. Lengths in
m, angles in deg. The world is upright with its origin in the arm's base. Positions of objects are from the table's
centre along its sides; the origin of an object is the middle of its height."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np

from common.config import integer, number, parse_part, vector
from common.errors import ConfigError
from common.poses import pose, translation
from common.rotations import rotation_about
from common.tag36h11 import CELLS, black_cells
from rig_simulation.world.mjcf import BOARD, OBJECT, body, geom

NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclasses.dataclass(frozen=True)
class Table:
    """The table: a board with a flat top."""

    centre: np.ndarray = vector(2, "m", low=-10.0, high=10.0, doc="middle of the top in the upright world")
    size: np.ndarray = vector(2, "m", above=0.0, high=10.0, doc="edges along the table's own x and y axes")
    yaw: float = number("deg", low=-180.0, high=180.0, doc="of the table's x axis")
    top: float = number("m", low=-10.0, high=10.0, doc="height of the top")
    friction: float = number(above=0.0, high=2.0, doc="sliding friction")


@dataclasses.dataclass(frozen=True)
class CameraPose:
    """Position and target of the camera."""

    position: np.ndarray = vector(3, "m", low=-10.0, high=10.0, doc="of camera_link in the upright world")
    target: np.ndarray = vector(3, "m", low=-10.0, high=10.0, doc="the point that the camera points at")

    def faults(self) -> list[str]:
        if np.linalg.norm((self.target - self.position)[:2]) < 1e-3:
            return ["target must not lie straight above or below the camera."]
        return []


@dataclasses.dataclass(frozen=True)
class SceneObject:
    """Common fields of all objects."""

    position: np.ndarray = vector(2, "m", low=-10.0, high=10.0, doc="from the table's centre along its sides")
    yaw: float = number("deg", low=-180.0, high=180.0, doc="turn about the vertical")
    mass: float = number("kg", above=0.0, high=5.0)
    friction: float = number(above=0.0, high=2.0, doc="sliding friction")
    colour: np.ndarray = vector(3, low=0.0, high=1.0, doc="red, green, blue")

    if TYPE_CHECKING:  # a field of some kinds and a property of others

        @property
        def height(self) -> float:
            """From the lowest point to the highest [m]."""


@dataclasses.dataclass(frozen=True)
class Cup(SceneObject):
    """A cup: a wall around a bottom, open above."""

    radius: float = number("m", above=0.01, high=0.2, doc="outer radius")
    height: float = number("m", above=0.01, high=0.5)
    wall: float = number("m", above=0.001, below=0.01, doc="thickness of wall and bottom")


@dataclasses.dataclass(frozen=True)
class Cuboid(SceneObject):
    """A solid box."""

    size: np.ndarray = vector(3, "m", above=0.005, high=0.8, doc="edges")

    @property
    def height(self) -> float:
        """Vertical edge [m]."""
        return float(self.size[2])


@dataclasses.dataclass(frozen=True)
class Ball(SceneObject):
    """A solid ball."""

    radius: float = number("m", above=0.005, high=0.3)

    @property
    def height(self) -> float:
        """Diameter [m]."""
        return 2.0 * self.radius


@dataclasses.dataclass(frozen=True)
class Cylinder(SceneObject):
    """A solid upright cylinder."""

    radius: float = number("m", above=0.005, high=0.2)
    height: float = number("m", above=0.005, high=0.5)


@dataclasses.dataclass(frozen=True)
class Bottle(SceneObject):
    """A cylinder with a narrower one on top."""

    radius: float = number("m", above=0.01, high=0.2)
    height: float = number("m", above=0.05, high=0.5, doc="with the neck")
    neck_radius: float = number("m", above=0.005, high=0.1)
    neck_height: float = number("m", above=0.01, high=0.2)

    def faults(self) -> list[str]:
        if self.neck_height >= self.height or self.neck_radius >= self.radius:
            return ["the neck must be lower and narrower than the bottle."]
        return []


@dataclasses.dataclass(frozen=True)
class Post:
    """A cylinder that stands fast on the table, or at its height beside it."""

    position: np.ndarray = vector(2, "m", low=-10.0, high=10.0, doc="from the table's centre along its sides")
    radius: float = number("m", above=0.005, high=0.2)
    height: float = number("m", above=0.005, high=2.0, doc="above the table top")


KINDS: dict[str, type[SceneObject]] = {"cup": Cup, "box": Cuboid, "ball": Ball, "cylinder": Cylinder, "bottle": Bottle}


@dataclasses.dataclass(frozen=True)
class Tag:
    """One tag36h11 on the marker board."""

    id: int = integer(low=0, high=4)
    size: float = number("m", above=0.01, high=0.5, doc="edge of the black square")
    position: np.ndarray = vector(2, "m", low=-1.0, high=1.0, doc="of its centre on the plate")


@dataclasses.dataclass(frozen=True)
class _Plate:
    size: np.ndarray = vector(2, "m", above=0.0, high=1.0, doc="edges along the tags' x and y axes")
    centre: np.ndarray = vector(3, "m", low=-1.0, high=1.0, doc="in the flange")


@dataclasses.dataclass(frozen=True)
class MarkerBoard(_Plate):
    """The marker board beside the flange, a plate with tags printed on it."""

    tags: tuple[Tag, ...] = ()


@dataclasses.dataclass(frozen=True)
class WorldScene:
    """A scene."""

    table: Table  # under the objects
    camera: CameraPose  # its pose
    scatter: float  # largest random offset of objects in x and y [m]; 0 places them exactly
    objects: Mapping[str, SceneObject]  # by name
    posts: Mapping[str, Post] = dataclasses.field(default_factory=dict)  # by name
    light: float = 1.0  # factor on its brightness


@dataclasses.dataclass(frozen=True)
class _Rest:
    scatter: float = number("m", low=0.0, high=0.2)
    light: float = number(low=0.1, high=2.0, doc="factor on the brightness", absent=1.0)


def scene_from(values: Any) -> WorldScene:
    """Returns the scene that a yaml mapping describes; raises ConfigError with all faults."""
    faults: list[str] = []
    rest = parse_part(_Rest, values, "", faults, ("table", "camera", "objects", "posts"))
    sections: Mapping[str, Any] = {"posts": {}, **values} if isinstance(values, Mapping) else {}
    names = ("table", "camera", "objects", "posts")
    table_values, camera_values, listed, standing = (_section(sections, key, faults) for key in names)
    if table_values is None or camera_values is None or listed is None or standing is None:
        raise ConfigError(faults)
    table = parse_part(Table, table_values, "table/", faults)
    camera = parse_part(CameraPose, camera_values, "camera/", faults)
    shapes = {name: _object(name, entry, faults) for name, entry in listed.items()}
    posts = {str(name): parse_part(Post, entry, f"posts/{name}/", faults) for name, entry in standing.items()}
    if faults or rest is None or table is None or camera is None:
        raise ConfigError(faults)
    objects = {name: shape for name, shape in shapes.items() if shape is not None}
    stand = {name: post for name, post in posts.items() if post}
    return WorldScene(table, camera, rest.scatter, objects, stand, rest.light)


def board_from(values: Any) -> MarkerBoard:
    """Returns the marker board that a yaml mapping describes; raises ConfigError with all faults."""
    faults: list[str] = []
    plate = parse_part(_Plate, values, "", faults, ("tags",))
    listed = values.get("tags") if isinstance(values, Mapping) else None
    if not isinstance(listed, list) or not listed:
        faults.append(f"tags is {listed!r}, but must be a list of tags.")
        listed = []
    tags = [parse_part(Tag, entry, f"tags/{i}/", faults) for i, entry in enumerate(listed)]
    if faults or plate is None:
        raise ConfigError(faults)
    return MarkerBoard(plate.size, plate.centre, tuple(tag for tag in tags if tag is not None))


def _section(values: Mapping[str, Any], key: str, faults: list[str]) -> Mapping[str, Any] | None:
    if key not in values:
        faults.append(f"{key} is missing; it must be a mapping.")
    elif not isinstance(values[key], Mapping):
        faults.append(f"{key} is {values[key]!r}, but must be a mapping.")
    else:
        return values[key]
    return None


def _object(name: Any, entry: Any, faults: list[str]) -> SceneObject | None:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        faults.append(f"objects/{name} is not a name of small letters, digits and underscores.")
    kind = entry.get("kind") if isinstance(entry, Mapping) else None
    if not isinstance(kind, str) or kind not in KINDS:
        faults.append(f"objects/{name}/kind is {kind!r}, but must be one of {', '.join(KINDS)}.")
        return None
    return parse_part(KINDS[kind], entry, f"objects/{name}/", faults, ("kind",))


_CORNERS = np.array([(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
_FACES = np.array(list("031023457476015054273267046062137175"), dtype=int).reshape(-1, 3)


def table_pose(table: Table) -> np.ndarray:
    """Returns the pose of the middle of the table top in the world, shape (4, 4)."""
    return pose(rotation_about(2, np.radians(table.yaw)), (*table.centre, table.top))


def add_table(world: ET.Element, table: Table, posts: Mapping[str, Post]) -> None:
    table_thickness = 0.03
    table_colour = (0.72, 0.6, 0.45)
    post_colour = (0.85, 0.65, 0.2)
    look: dict[str, Any] = {"friction": table.friction, "colour": table_colour}
    half = (*(table.size / 2.0), table_thickness / 2.0)
    geom(body(world, "table", table_pose(table)), "table", BOARD, "box", half, p=(0, 0, -table_thickness / 2.0), **look)
    for name, post in posts.items():
        size = (post.radius, post.height / 2.0)
        x, y = post.position.tolist()
        standing = body(world, f"post/{name}", table_pose(table) @ translation(x, y, post.height / 2.0))
        geom(standing, f"post/{name}", BOARD, "cylinder", size, friction=table.friction, colour=post_colour)


def add_object(world: ET.Element, name: str, shape: SceneObject) -> None:
    """Adds a free object; a reset sets its pose."""
    # A round bottom stands on small balls: a cylinder on a box has few, unsteady contact points.
    feet = 8
    foot_radius = 0.0025
    foot_out = 0.0005
    prefix = f"object/{name}"
    element = body(world, prefix, np.eye(4))
    ET.SubElement(element, "freejoint", name=prefix)
    look: dict[str, Any] = {"friction": shape.friction, "colour": shape.colour}
    if isinstance(shape, Cuboid):
        geom(element, f"{prefix}/box", OBJECT, "box", shape.size / 2.0, mass=shape.mass, **look)
    elif isinstance(shape, Ball):
        geom(element, f"{prefix}/ball", OBJECT, "sphere", [shape.radius], mass=shape.mass, **look)
    elif isinstance(shape, Cup):
        _cup(element, prefix, shape, look)
    elif isinstance(shape, Cylinder):
        size = (shape.radius, shape.height / 2.0)
        geom(element, f"{prefix}/body", OBJECT, "cylinder", size, mass=shape.mass, **look)
    elif isinstance(shape, Bottle):
        _bottle(element, prefix, shape, look)
    else:
        raise TypeError(f"There is no shape for {type(shape).__name__}.")
    if isinstance(shape, (Cup, Cylinder, Bottle)):
        across = shape.radius - foot_radius
        for i, angle in enumerate(2.0 * np.pi * (np.arange(feet) + 0.5) / feet):
            middle = (across * np.cos(angle), across * np.sin(angle), foot_radius - foot_out - shape.height / 2.0)
            geom(element, f"{prefix}/foot_{i}", OBJECT, "sphere", [foot_radius], p=middle, mass=1e-6, **look)


def _cup(element: ET.Element, prefix: str, cup: Cup, look: dict[str, Any]) -> None:
    wall_plates = 16
    bottom_fraction = 0.25  # fraction of a cup's mass in its bottom
    bottom, below = (cup.radius, cup.wall / 2.0), (0, 0, cup.wall / 2.0 - cup.height / 2.0)
    geom(element, f"{prefix}/bottom", OBJECT, "cylinder", bottom, p=below, mass=bottom_fraction * cup.mass, **look)
    mass = (1.0 - bottom_fraction) * cup.mass / wall_plates
    half = (cup.wall / 2.0, cup.radius * np.tan(np.pi / wall_plates), (cup.height - cup.wall) / 2.0)
    for i in range(wall_plates):
        R = rotation_about(2, 2.0 * np.pi * i / wall_plates)
        middle = R @ np.array([cup.radius - cup.wall / 2.0, 0.0, cup.wall / 2.0])
        geom(element, f"{prefix}/wall_{i}", OBJECT, "box", half, p=middle, R=R, mass=mass, **look)


def _bottle(element: ET.Element, prefix: str, bottle: Bottle, look: dict[str, Any]) -> None:
    low, high = bottle.height - bottle.neck_height, bottle.neck_height
    volumes = np.array([bottle.radius**2 * low, bottle.neck_radius**2 * high])
    masses = bottle.mass * volumes / volumes.sum()
    below, above = (0, 0, (low - bottle.height) / 2.0), (0, 0, (bottle.height - high) / 2.0)
    body_size, neck_size = (bottle.radius, low / 2.0), (bottle.neck_radius, high / 2.0)
    geom(element, f"{prefix}/body", OBJECT, "cylinder", body_size, p=below, mass=masses[0], **look)
    geom(element, f"{prefix}/neck", OBJECT, "cylinder", neck_size, p=above, mass=masses[1], **look)


def tag_mesh(tag: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the black cells of a tag as thin plates on z = 0, exact edges that no renderer can blur or mirror:
    vertices, shape (n, 3) [m], and triangles, shape (m, 3); origin in the middle, x to the right, y up. `tag`: id, an
    index of common.tag36h11.CODES; `size`: edge of the black square [m]."""
    tag_thickness = 0.0002
    cell = size / CELLS
    vertices: list[np.ndarray] = []
    for row, cells in enumerate(black_cells(tag)):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2):
            low = np.array([start * cell - size / 2.0, size / 2.0 - (row + 1) * cell, 0.0])
            high = np.array([end * cell - size / 2.0, size / 2.0 - row * cell, tag_thickness])
            vertices.append(low + _CORNERS * (high - low))
    return np.concatenate(vertices), np.concatenate([_FACES + 8 * i for i in range(len(vertices))])
