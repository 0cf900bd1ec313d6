"""Elements of MuJoCo's model format and of URDF. Lengths in m, angles in rad, poses as 4x4 matrices."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from xml.etree import ElementTree as ET

import numpy as np

from common.rotations import quaternion_from_rotation


@dataclasses.dataclass(frozen=True)
class Touch:
    """The contacts of a kind of geom: two geoms touch if the kind of one is among the partners of the other."""

    kind: int  # its own bit
    partners: int  # bits of the kinds that it touches
    group: int  # visibility group of MuJoCo; 3 and above are hidden


ROBOT = Touch(kind=1, partners=2, group=3)
BOARD = Touch(kind=2, partners=1, group=0)
OBJECT = Touch(kind=2, partners=3, group=0)
VISUAL = Touch(kind=0, partners=0, group=1)

NOTHING: Mapping[str, str] = MappingProxyType({})


def body(parent: ET.Element, name: str, T: np.ndarray) -> ET.Element:
    """Adds a body at the pose T in its parent, shape (4, 4)."""
    return ET.SubElement(parent, "body", name=name, pos=numbers(T[:3, 3]), quat=quaternion(T[:3, :3]))


def geom(
    parent: ET.Element,
    name: str,
    touch: Touch,
    kind: str,
    size: Iterable[float] | None,
    p: Iterable[float] = (0, 0, 0),
    R: np.ndarray | None = None,
    friction: float | None = None,
    mass: float | None = None,
    colour: Iterable[float] | None = None,
    more: Mapping[str, str] = NOTHING,
) -> ET.Element:
    """Adds a geom.

    Args:
        size: as MuJoCo defines it: half lengths of a box, radius and half length of a cylinder.
        p, R: its pose in the body.
        friction: sliding friction.
        mass: [kg]; None if the body has a mass of its own.
        colour: red, green, blue.
        more: further attributes of MuJoCo.
    """
    values = {
        "name": name,
        "type": kind,
        "pos": numbers(p),
        "contype": str(touch.kind),
        "conaffinity": str(touch.partners),
        "group": str(touch.group),
        **more,
    }
    if size is not None:
        values["size"] = numbers(size)
    if R is not None:
        values["quat"] = quaternion(R)
    if friction is not None:
        values["friction"] = numbers((friction, 0.005, 0.0001))
    values["mass"] = numbers([0.0 if mass is None else mass])
    if colour is not None:
        values["rgba"] = numbers((*colour, 1.0))
    return ET.SubElement(parent, "geom", values)


def quaternion(R: np.ndarray) -> str:
    """Returns a rotation, shape (3, 3), as a quaternion in MuJoCo's order: w first."""
    x, y, z, w = quaternion_from_rotation(R)
    return numbers((w, x, y, z))


def numbers(values: Iterable[float]) -> str:
    """Returns numbers as text that reads back as the same doubles."""
    return " ".join(repr(float(value)) for value in values)


def child(element: ET.Element, path: str) -> ET.Element:
    """Returns the first element at a path below this one.

    Raises:
        ValueError: it does not exist.
    """
    found = element.find(path)
    if found is None:
        raise ValueError(f"The element <{element.tag}> has no {path}.")
    return found


def attribute(element: ET.Element, name: str) -> str:
    """Returns the value of an attribute.

    Raises:
        ValueError: it does not exist.
    """
    value = element.get(name)
    if value is None:
        raise ValueError(f"The element <{element.tag}> has no attribute {name}.")
    return value
