"""The arm with a media flange and the hand as URDF text."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from math import pi, radians
from typing import NamedTuple
from xml.dom import minidom
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from iiwa_kinematics.robot_model import FLANGE_HEIGHTS, WRIST_LINK_7
from rig_description import arms, hand
from rig_description.rigid_body import Body, cylinder
from rig_description.shapes import COLOURS, LOOK, Disc, arm_trim, hand_trim, media_flange

TABLE_HALF = 0.45
TABLE_THICKNESS = 0.04


class _Placed(NamedTuple):
    """A geometry and its place: attributes of the URDF element `origin`; name and attributes of the geometry."""

    origin: dict[str, str]
    geometry: tuple[str, dict[str, str]]


def file_name(robot: str, flange: str, ring: bool = False) -> str:
    """Returns the path below urdf/ of the file of an arm and a media flange; `ring`: with that of the marker board."""
    return f"{'with_ring/' if ring else ''}{robot.lower()}_{flange}.urdf"


def urdf(robot: str, flange: str, ring: bool = False) -> str:
    """Returns the URDF of an arm and a media flange, names as in the parameters kuka/robot and kuka/flange. `ring`: the
    ring of the marker board is clamped between flange and connector. Raises KeyError for unknown names."""
    arm, height = arms.ARMS[robot], FLANGE_HEIGHTS[flange]
    root = ET.Element("robot", name=f"{robot}_{flange}")
    table = ET.SubElement(root, "link", name="kuka/base_frame")
    _shown(table, _box((-TABLE_HALF, -TABLE_HALF, -TABLE_THICKNESS), (TABLE_HALF, TABLE_HALF, 0.0)), "table")
    _arm(root, arm)
    _flange(root, flange, height)
    if ring:
        _ring(root)
    _hand(root, hand.CONNECTOR_LENGTH + (hand.RING_LENGTH if ring else 0.0))
    tools = f"{flange}, ring of the marker board" if ring else flange
    note = f"{robot} with {tools} and ReFlex TakkTile hand. Written by tools/generate.py of rig_description."
    root.insert(0, ET.Comment(f" {note} "))
    return minidom.parseString(ET.tostring(root)).toprettyxml(indent="  ", encoding="utf-8").decode()


def all_files() -> dict[str, str]:
    """Returns the text of every URDF file by its path below the package's folder."""
    variants = itertools.product(arms.ARMS, FLANGE_HEIGHTS, (False, True))
    return {f"urdf/{file_name(*variant)}": urdf(*variant) for variant in variants}


def _arm(root: ET.Element, arm: arms.ArmDescription) -> None:
    for number in range(8):
        link = _link(root, f"kuka/link_{number}", arms.link_body(arm, number), _cylinder(*arms.tube(arm, number)))
        R = arms.upright(number).T
        if number < 7:
            roll = np.arctan2(R[2, 1], R[1, 1])
            _shown(link, _mesh(f"{arm.model.name.lower()}/link_{number}", roll))
        _discs(link, arm_trim(arm, number), R)
    _joint(root, "kuka/base", "kuka/base_frame", "kuka/link_0")
    model = arm.model
    limits = zip(model.lower, model.upper)
    for number, alpha, limit, speed, torque in zip(range(1, 8), arms.ALPHA_DEG, limits, model.max_speed, arm.torques):
        ends = f"kuka/link_{number - 1}", f"kuka/link_{number}"
        rpy = (radians(alpha), 0.0, 0.0)
        joint = _joint(root, f"kuka/joint_{number}", *ends, xyz=arms.origin_in_parent(arm, number), rpy=rpy)
        _movable(joint, (0, 0, 1), limit, speed, torque)


def _flange(root: ET.Element, name: str, height: float) -> None:
    mass = round(arms.MEDIA_FLANGE_DENSITY * pi * arms.MEDIA_FLANGE_RADIUS**2 * height, 3)
    shape = arms.MEDIA_FLANGE_RADIUS, np.array([0.0, 0.0, -height]), np.zeros(3)
    link = _link(root, "kuka/flange", cylinder(mass, *shape), _cylinder(*shape))
    _discs(link, media_flange(name, 1e3 * height), np.eye(3))
    _joint(root, "kuka/media_flange", "kuka/link_7", "kuka/flange", xyz=(0, 0, WRIST_LINK_7 + height))


def _ring(root: ET.Element) -> None:
    shapes = [_cylinder(hand.CONNECTOR_RADIUS, *hand.RING_FACES), _box(*hand.RING_PAD), _box(*hand.RING_ARM)]
    link = _link(root, "kuka/marker_connector", hand.ring_body(), *shapes)
    for shape in shapes:
        _shown(link, shape, "grey")
    _joint(root, "kuka/marker_ring", "kuka/flange", "kuka/marker_connector")


def _hand(root: ET.Element, beyond: float) -> None:
    for name in hand.LINKS:
        part = hand.part(name)
        collisions = [_box(*hand.EXTENT[part])]
        if name == "base_link":
            collisions.append(_cylinder(hand.CONNECTOR_RADIUS, *hand.CONNECTOR_FACES))
        link = _link(root, f"reflex/{name}", hand.body(name), *collisions)
        for mesh in LOOK[part]:
            _shown(link, _mesh(f"reflex/{mesh}"))
        _discs(link, hand_trim(part), np.eye(3))
    ends = "kuka/flange", "reflex/base_link"
    _joint(root, "reflex/connector", *ends, xyz=(0, 0, beyond), rpy=(0, 0, hand.CONNECTOR_YAW))
    for j in hand.JOINTS:
        ends = f"reflex/{j.parent}", f"reflex/{j.child}"
        joint = _joint(root, f"reflex/{j.name}", *ends, xyz=j.xyz, rpy=(0, 0, j.yaw))
        _movable(joint, j.axis, j.limits, hand.TENDON_SPEED, hand.TENDON_TORQUE)


def _link(root: ET.Element, name: str, body: Body, *collisions: _Placed) -> ET.Element:
    link = ET.SubElement(root, "link", name=name)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=decimals(body.com), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=decimal(body.mass))
    xx, xy, xz, _, yy, yz, _, _, zz = (decimal(value, 9) for value in np.asarray(body.inertia).ravel())
    ET.SubElement(inertial, "inertia", ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz)
    for collision in collisions:
        _place(ET.SubElement(link, "collision"), collision)
    return link


def _discs(link: ET.Element, discs: list[Disc], R: np.ndarray) -> None:
    for disc in discs:
        bottom, top = (R @ np.array(point) / 1e3 for point in (disc.bottom, disc.top))
        _shown(link, _cylinder(disc.radius / 1e3, bottom, top), disc.colour)


def _shown(link: ET.Element, placed: _Placed, colour: str | None = None) -> None:
    """Adds a visual element; meshes bring their own colour."""
    visual = ET.SubElement(link, "visual")
    _place(visual, placed)
    if colour is not None:
        material = ET.SubElement(visual, "material", name=f"rig/{colour}")
        ET.SubElement(material, "color", rgba=decimals((*COLOURS[colour], 1.0)))


def _place(element: ET.Element, placed: _Placed) -> None:
    name, attributes = placed.geometry
    ET.SubElement(element, "origin", placed.origin)
    ET.SubElement(ET.SubElement(element, "geometry"), name, attributes)


def _joint(
    root: ET.Element,
    name: str,
    parent: str,
    child: str,
    xyz: Iterable[float] = (0, 0, 0),
    rpy: Iterable[float] = (0, 0, 0),
) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    ET.SubElement(joint, "origin", xyz=decimals(xyz), rpy=decimals(rpy, 15))
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    return joint


def _movable(joint: ET.Element, axis: Iterable[float], limits: Iterable[float], speed: float, torque: float) -> None:
    joint.set("type", "revolute")
    ET.SubElement(joint, "axis", xyz=decimals(axis))
    lower, upper = (decimal(value, 15) for value in limits)
    ET.SubElement(joint, "limit", lower=lower, upper=upper, velocity=decimal(speed, 15), effort=decimal(torque))


def _cylinder(radius: float, bottom: np.ndarray, top: np.ndarray) -> _Placed:
    """Returns a cylinder between two points [m] whose axis lies across x."""
    axis = top - bottom
    origin = {"xyz": decimals((bottom + top) / 2.0), "rpy": decimals((np.arctan2(-axis[1], axis[2]), 0, 0))}
    length = np.sqrt((axis**2).sum())
    return _Placed(origin, ("cylinder", {"radius": decimal(radius), "length": decimal(length)}))


def _mesh(name: str, roll: float = 0.0) -> _Placed:
    attributes = {"filename": f"package://rig_description/meshes/{name}.dae", "scale": "0.001 0.001 0.001"}
    return _Placed({"xyz": "0 0 0", "rpy": decimals((roll, 0, 0), 15)}, ("mesh", attributes))


def _box(low: ArrayLike, high: ArrayLike) -> _Placed:
    low, high = np.array(low), np.array(high)
    return _Placed({"xyz": decimals((low + high) / 2.0), "rpy": "0 0 0"}, ("box", {"size": decimals(high - low)}))


def decimals(values: Iterable[float], digits: int = 6) -> str:
    """Returns numbers as short text, separated by blanks."""
    return " ".join(decimal(value, digits) for value in values)


def decimal(value: float, digits: int = 6) -> str:
    """Returns a number as short text, of at most so many digits behind the point."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
