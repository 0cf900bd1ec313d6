"""The robot of a URDF as it is drawn: its links as one tree, and the surfaces of each. Lengths in m, angles in rad."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import numpy as np
import trimesh

from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_from_zyx
from rig_description.meshes import surface_from_collada

MOST_LINKS = 200


class DescriptionFault(ValueError):
    """The robot description cannot be drawn; the message says why."""


@dataclass(frozen=True)
class LinkShape:
    """One visual shape of a link."""

    T_link_shape: np.ndarray
    mesh: str  # the address of a file, or empty
    scale: np.ndarray
    kind: str  # box, cylinder or sphere, if there is no file
    size: tuple[float, ...]
    colour: tuple[float, ...] | None


@dataclass(frozen=True)
class DrawnLink:
    """A link with the joint that carries it."""

    name: str
    parent: str  # the link that it hangs on; empty for the first one
    joint: str
    moves: bool
    T_parent_link: np.ndarray  # at the joint's zero
    axis: np.ndarray
    shapes: list[LinkShape] = field(default_factory=list)

    def at(self, angle: float) -> tuple[float, ...]:
        """Returns the pose in the parent at an angle of the joint, seven numbers."""
        x, y, z, w = quaternion_from_rotation(self.T_parent_link[:3, :3]).tolist()
        s, c = math.sin(0.5 * angle), math.cos(0.5 * angle)
        a, b, d = (s * self.axis).tolist()
        turned = (
            w * a + x * c + y * d - z * b,
            w * b - x * d + y * c + z * a,
            w * d + x * b - y * a + z * c,
            w * c - x * a - y * b - z * d,
        )
        return (*self.T_parent_link[:3, 3].tolist(), *turned)


def links_of(urdf: str) -> list[DrawnLink]:
    """Returns the links of a robot description, each after the one that it hangs on; raises DescriptionFault."""
    try:
        root = ET.fromstring(urdf)
        shapes = {_text(link, "name"): _shapes(link) for link in root.findall("link")}
        joints = {_text(_child(joint, "child"), "link"): joint for joint in root.findall("joint")}
        if not 0 < len(shapes) <= MOST_LINKS:
            raise DescriptionFault(f"The robot description has {len(shapes)} links.")
        links: dict[str, DrawnLink] = {}
        while len(links) < len(shapes):
            ready = [name for name in shapes if name not in links and _parent(joints.get(name)) in (*links, "")]
            if not ready:
                raise DescriptionFault("Not all links of the robot description hang on one another.")
            links.update((name, _link(name, joints.get(name), shapes[name])) for name in ready)
    except (ET.ParseError, ValueError, KeyError) as error:
        raise DescriptionFault(f"The robot description cannot be read: {error}") from error
    return list(links.values())


@dataclass(frozen=True)
class Surface:
    """Part of a link of one colour: vertices in the link, shape (n, 3); triangles, shape (m, 3); colour in bytes."""

    vertices: np.ndarray
    triangles: np.ndarray
    colour: tuple[int, ...]
    smooth: bool


def surfaces_of(link: DrawnLink, read_mesh: Callable[[str], str]) -> list[Surface]:
    """Returns the shapes of a link, those of one colour together. `read_mesh` returns the text of a file. Raises
    DescriptionFault or OSError."""
    parts: dict[tuple, list[tuple[np.ndarray, np.ndarray]]] = {}
    for shape in link.shapes:
        vertices, triangles, colour, smooth = _surface(shape, read_mesh)
        placed = vertices @ shape.T_link_shape[:3, :3].T + shape.T_link_shape[:3, 3]
        parts.setdefault((tuple(int(255 * part) for part in colour), smooth), []).append((placed, triangles))
    return [_whole(found, *look) for look, found in parts.items()]


def _whole(parts: list[tuple[np.ndarray, np.ndarray]], colour: tuple[int, ...], smooth: bool) -> Surface:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = np.vstack([faces + start for (_, faces), start in zip(parts, starts)])
    return Surface(np.vstack([vertices for vertices, _ in parts]), triangles, colour, smooth)


def _surface(shape: LinkShape, read_mesh: Callable[[str], str]) -> tuple[np.ndarray, np.ndarray, Sequence[float], bool]:
    """Returns vertices, triangles, colour, and whether it is smooth."""
    grey = (0.7, 0.7, 0.7)
    if shape.mesh:
        try:
            vertices, triangles, colour = surface_from_collada(read_mesh(shape.mesh))
        except (ValueError, ET.ParseError) as error:
            raise DescriptionFault(f"{shape.mesh} cannot be drawn: {error}") from error
        return vertices * shape.scale, triangles, (shape.colour or colour.tolist())[:3], True
    if shape.kind == "box":
        mesh = trimesh.creation.box(shape.size)
    elif shape.kind == "cylinder":
        mesh = trimesh.creation.cylinder(radius=shape.size[0], height=shape.size[1], sections=48)
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=shape.size[0])
    return mesh.vertices, mesh.faces, (shape.colour or grey)[:3], shape.kind == "sphere"


def _link(name: str, joint: ET.Element | None, shapes: list[LinkShape]) -> DrawnLink:
    if joint is None:
        return DrawnLink(name, "", "", False, np.eye(4), np.array([0.0, 0.0, 1.0]), shapes)
    axis = joint.find("axis")
    direction = np.array(_numbers(axis.get("xyz", "1 0 0"), 3) if axis is not None else (1.0, 0.0, 0.0))
    moves = joint.get("type") in ("revolute", "continuous")
    direction = direction / np.linalg.norm(direction) if moves else direction
    if not np.isfinite(direction).all():
        raise DescriptionFault(f"The joint {joint.get('name')!r} has no axis.")
    return DrawnLink(name, _parent(joint), joint.get("name", ""), moves, _origin(joint), direction, shapes)


def _shapes(link: ET.Element) -> list[LinkShape]:
    found = []
    for visual in link.findall("visual"):
        geometry = next(iter(_child(visual, "geometry")), None)
        if geometry is None:
            continue
        colour = visual.find("material/color")
        rgba = None if colour is None else _numbers(_text(colour, "rgba"), 4)
        mesh, scale = "", np.ones(3)
        size: tuple[float, ...] = ()
        if geometry.tag == "mesh":
            mesh, scale = _text(geometry, "filename"), np.array(_numbers(geometry.get("scale", "1 1 1"), 3))
        elif geometry.tag == "box":
            size = _numbers(_text(geometry, "size"), 3)
        elif geometry.tag == "cylinder":
            size = *_numbers(_text(geometry, "radius"), 1), *_numbers(_text(geometry, "length"), 1)
        elif geometry.tag == "sphere":
            size = _numbers(_text(geometry, "radius"), 1)
        else:
            raise DescriptionFault(f"{geometry.tag!r} is no shape of a robot description.")
        found.append(LinkShape(_origin(visual), mesh, scale, geometry.tag, size, rgba))
    return found


def _origin(element: ET.Element) -> np.ndarray:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    roll, pitch, yaw = _numbers(origin.get("rpy", "0 0 0"), 3)
    return pose(rotation_from_zyx(yaw, pitch, roll), _numbers(origin.get("xyz", "0 0 0"), 3))


def _parent(joint: ET.Element | None) -> str:
    return "" if joint is None else _text(_child(joint, "parent"), "link")


def _child(element: ET.Element, name: str) -> ET.Element:
    found = element.find(name)
    if found is None:
        raise DescriptionFault(f"The element <{element.tag}> has no <{name}>.")
    return found


def _text(element: ET.Element, name: str) -> str:
    value = element.get(name)
    if value is None:
        raise DescriptionFault(f"The element <{element.tag}> has no attribute {name}.")
    return value


def _numbers(text: str, count: int) -> tuple[float, ...]:
    values = tuple(float(word) for word in text.split())
    if len(values) != count or not all(map(math.isfinite, values)):
        raise DescriptionFault(f"{text!r} should be {count} numbers.")
    return values
