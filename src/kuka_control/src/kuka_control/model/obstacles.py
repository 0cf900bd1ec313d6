"""Convex bodies that the collision guard knows: shapes, and the file of obstacles around the arm. Lengths in m,
angles in deg. Poses are in kuka/base_frame, or in kuka/flange for what is mounted there."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.config import choice, number, parse_part, vector
from common.errors import ConfigError
from common.poses import pose, read_only
from common.rotations import rotation_from_zyx


@dataclass(frozen=True)
class ConvexShape:
    """A convex shape in its middle; cylinder and capsule along z. `size` in m: box: its three edges; sphere: radius;
    cylinder: radius, height; capsule: radius, distance of the centres of its two ends."""

    kind: str
    size: tuple[float, ...]

    @property
    def radius(self) -> float:
        """Of a ball about its middle that encloses it [m]."""
        first, *others = self.size
        if self.kind == "box":
            return 0.5 * math.hypot(*self.size)
        if self.kind == "cylinder":
            return math.hypot(first, 0.5 * others[0])
        return first + 0.5 * sum(others)


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A named shape that moves with a link of the arm; link 0 is the base, with all that stands around it."""

    name: str
    link: int
    shape: ConvexShape
    T_link_body: np.ndarray  # shape (4, 4) [m]; the axes of a link are those of the base while all joints are zero
    finger: bool = False  # whether it may touch what the parameter allow_contact names


@dataclass(frozen=True)
class Obstacle(ABC):
    """Common keys of all obstacles."""

    position: np.ndarray = vector(3, "m", low=-3.0, high=3.0, doc="of the middle, in its frame")
    rpy: np.ndarray = vector(3, "deg", low=-180.0, high=180.0, doc="roll, pitch, yaw", absent=[0.0, 0.0, 0.0])
    frame: str = choice("base", "flange", doc="what it is mounted to", absent="base")

    @property
    @abstractmethod
    def shape(self) -> ConvexShape:
        """Its shape."""


@dataclass(frozen=True)
class BoxObstacle(Obstacle):
    """A box."""

    size: np.ndarray = vector(3, "m", above=0.0, high=5.0, doc="edges")

    @property
    def shape(self) -> ConvexShape:
        """Its shape."""
        return ConvexShape("box", tuple(self.size.tolist()))


@dataclass(frozen=True)
class SphereObstacle(Obstacle):
    """A sphere."""

    radius: float = number("m", above=0.0, high=2.0)

    @property
    def shape(self) -> ConvexShape:
        """Its shape."""
        return ConvexShape("sphere", (self.radius,))


@dataclass(frozen=True)
class CylinderObstacle(SphereObstacle):
    """A cylinder along its z axis."""

    height: float = number("m", above=0.0, high=5.0, doc="along z")

    @property
    def shape(self) -> ConvexShape:
        """Its shape."""
        return ConvexShape("cylinder", (self.radius, self.height))


@dataclass(frozen=True)
class CapsuleObstacle(CylinderObstacle):
    """A cylinder along its z axis with a half sphere on each end; `height` is without them."""

    @property
    def shape(self) -> ConvexShape:
        """Its shape."""
        return ConvexShape("capsule", (self.radius, self.height))


BUILT_IN = frozenset(
    ["base", "base plugs", "flange", "marker ring", "palm", "table"]
    + [f"link {i}" for i in range(1, 7)]
    + [f"reach of finger {i}" for i in (1, 2, 3)]
)
"""The names of the bodies that the guard knows by itself."""

KINDS: dict[str, type[Obstacle]] = {
    "box": BoxObstacle,
    "sphere": SphereObstacle,
    "cylinder": CylinderObstacle,
    "capsule": CapsuleObstacle,
}


def obstacles_from(values: Any, wrist_flange: float, prefix: str = "") -> tuple[ConvexBody, ...]:
    """Returns the obstacles that a yaml mapping of names describes; raises ConfigError with all faults.
    `wrist_flange`: length of the arm's last link [m]; `prefix` stands before each key in messages."""
    if not isinstance(values, Mapping):
        raise ConfigError([f"{prefix or 'The file '}is {values!r}, but must be a mapping of names to obstacles."])
    faults: list[str] = []
    bodies = []
    for name, entry in values.items():
        if str(name) in BUILT_IN:
            faults.append(f"{prefix}{name} is the name of a body that the guard knows by itself; use another name.")
            continue
        kind = entry.get("kind") if isinstance(entry, Mapping) else None
        if not isinstance(kind, str) or kind not in KINDS:
            faults.append(f"{prefix}{name}/kind is {kind!r}, but must be one of {', '.join(KINDS)}.")
            continue
        obstacle = parse_part(KINDS[kind], entry, f"{prefix}{name}/", faults, ("kind",))
        if obstacle is not None:
            roll, pitch, yaw = np.radians(obstacle.rpy)
            T = pose(rotation_from_zyx(yaw, pitch, roll), obstacle.position)
            mounted = obstacle.frame == "flange"
            T[2, 3] += wrist_flange if mounted else 0.0
            bodies.append(ConvexBody(str(name), 7 if mounted else 0, obstacle.shape, read_only(T)))
    if faults:
        raise ConfigError(faults)
    return tuple(bodies)
