"""The content of the simulated world besides the rig: the schema of a scene's yaml, and its records.

Lengths in m, angles in deg. The world is upright with its origin in the arm's base. Positions of objects are from the
table's centre along its sides; the origin of an object is the middle of its height.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from common.config import integer, number, parse_part, vector
from common.errors import ConfigError

NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclasses.dataclass(frozen=True)
class Table:
    """The table: a board with a flat top."""

    centre: np.ndarray = vector(2, "m", doc="middle of the top in the upright world")
    size: np.ndarray = vector(2, "m", above=0.0, doc="edges along the table's own x and y axes")
    yaw: float = number("deg", low=-180.0, high=180.0, doc="of the table's x axis")
    top: float = number("m", doc="height of the top")
    friction: float = number(above=0.0, high=2.0, doc="sliding friction")


@dataclasses.dataclass(frozen=True)
class CameraPose:
    """Position and target of the camera."""

    position: np.ndarray = vector(3, "m", doc="of camera_link in the upright world")
    target: np.ndarray = vector(3, "m", doc="the point that the camera points at")

    def faults(self) -> list[str]:
        """Returns faults of several fields together."""
        if np.linalg.norm((self.target - self.position)[:2]) < 1e-3:
            return ["target must not lie straight above or below the camera."]
        return []


@dataclasses.dataclass(frozen=True)
class SceneObject:
    """Common fields of all objects."""

    position: np.ndarray = vector(2, "m", doc="from the table's centre along its sides")
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

    size: np.ndarray = vector(3, "m", above=0.005, high=0.5, doc="edges")

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
        """Returns faults of several fields together."""
        if self.neck_height >= self.height or self.neck_radius >= self.radius:
            return ["the neck must be lower and narrower than the bottle."]
        return []


KINDS: Mapping[str, type[SceneObject]] = {
    "cup": Cup,
    "box": Cuboid,
    "ball": Ball,
    "cylinder": Cylinder,
    "bottle": Bottle,
}


@dataclasses.dataclass(frozen=True)
class Tag:
    """One tag36h11 on the marker board."""

    id: int = integer(low=0, high=4)
    size: float = number("m", above=0.01, high=0.5, doc="edge of the black square")
    position: np.ndarray = vector(2, "m", doc="of its centre on the plate")


@dataclasses.dataclass(frozen=True)
class MarkerBoard:
    """The marker board beside the flange."""

    size: np.ndarray  # edges of the plate along the tags' x and y axes, shape (2,) [m]
    centre: np.ndarray  # of the plate in the flange, shape (3,) [m]
    tags: tuple[Tag, ...]  # printed on it


@dataclasses.dataclass(frozen=True)
class WorldScene:
    """A scene."""

    table: Table  # under the objects
    camera: CameraPose  # its pose
    scatter: float  # largest random offset of objects in x and y [m]; 0 places them exactly
    objects: Mapping[str, SceneObject]  # by name


@dataclasses.dataclass(frozen=True)
class _Rest:
    scatter: float = number("m", low=0.0, high=0.2)


def scene_from(values: Any) -> WorldScene:
    """Returns the scene that a yaml mapping describes.

    Raises:
        ConfigError: with all faults.
    """
    faults: list[str] = []
    rest = parse_part(_Rest, values, "", faults, ("table", "camera", "objects"))
    sections = values if isinstance(values, Mapping) else {}
    table_values, camera_values, listed = (_section(sections, key, faults) for key in ("table", "camera", "objects"))
    if table_values is None or camera_values is None or listed is None:
        raise ConfigError(faults)
    table = parse_part(Table, table_values, "table/", faults)
    camera = parse_part(CameraPose, camera_values, "camera/", faults)
    shapes = {name: _object(name, entry, faults) for name, entry in listed.items()}
    if faults or rest is None or table is None or camera is None:
        raise ConfigError(faults)
    return WorldScene(table, camera, rest.scatter, {name: shape for name, shape in shapes.items() if shape is not None})


def board_from(values: Any) -> MarkerBoard:
    """Returns the marker board that a yaml mapping describes.

    Raises:
        ConfigError: with all faults.
    """
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


@dataclasses.dataclass(frozen=True)
class _Plate:
    size: np.ndarray = vector(2, "m", above=0.0, high=1.0)
    centre: np.ndarray = vector(3, "m", low=-1.0, high=1.0)


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
