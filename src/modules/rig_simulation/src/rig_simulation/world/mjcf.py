"""Elements of MuJoCo's model format and of URDF, and the arm and the hand as bodies of the physics. Lengths in m,
angles in rad, poses as 4x4 matrices. The robot has frames, masses, shapes and names of its URDF. Contacts use the
collision shapes of the URDF; arm and hand do not touch each other. Meshes are visual only."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from xml.etree import ElementTree as ET

import numpy as np

from common.frames import BASE
from common.poses import pose
from common.rotations import quaternion_from_rotation, rotation_from_zyx
from rig_description.meshes import surface_from_collada
from rig_simulation.devices.sunrise.robot import JOINTS
from rig_simulation.files import read_mesh


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


def body(parent: ET.Element, name: str, T: np.ndarray) -> ET.Element:
    """Adds a body at the pose T in its parent, shape (4, 4)."""
    return ET.SubElement(parent, "body", name=name, pos=numbers(T[:3, 3]), quat=quaternion(T[:3, :3]))


def geom(
    parent: ET.Element,
    name: str,
    touch: Touch,
    kind: str,
    size: Iterable[float] | None,  # as in MuJoCo: half lengths of a box, radius and half length of a cylinder
    p: Iterable[float] = (0, 0, 0),  # with R its pose in the body
    R: np.ndarray | None = None,
    friction: float | None = None,  # sliding friction
    mass: float = 0.0,  # [kg]; 0 if the body has a mass of its own
    colour: Iterable[float] | None = None,  # red, green, blue
    **more: str,  # further attributes of MuJoCo
) -> ET.Element:
    values = {"name": name, "type": kind, "pos": numbers(p), "mass": numbers([mass])}
    values.update(contype=str(touch.kind), conaffinity=str(touch.partners), group=str(touch.group))
    if size is not None:
        values["size"] = numbers(size)
    if R is not None:
        values["quat"] = quaternion(R)
    if friction is not None:
        values["friction"] = numbers((friction, 0.005, 0.0001))
    if colour is not None:
        values["rgba"] = numbers((*colour, 1.0))
    return ET.SubElement(parent, "geom", {**values, **more})


def quaternion(R: np.ndarray) -> str:
    """Returns a rotation, shape (3, 3), as a quaternion in MuJoCo's order: w first."""
    return numbers(quaternion_from_rotation(R)[[3, 0, 1, 2]])


def numbers(values: Iterable[float]) -> str:
    """Returns numbers as text that reads back as the same doubles."""
    return " ".join(repr(float(value)) for value in values)


def child(element: ET.Element, path: str) -> ET.Element:
    """Returns the first element at a path below this one; raises ValueError if it does not exist."""
    found = element.find(path)
    if found is None:
        raise ValueError(f"The element <{element.tag}> has no {path}.")
    return found


def attribute(element: ET.Element, name: str) -> str:
    """Returns the value of an attribute; raises ValueError if it does not exist."""
    value = element.get(name)
    if value is None:
        raise ValueError(f"The element <{element.tag}> has no attribute {name}.")
    return value


def add_mesh(asset: ET.Element, name: str, vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Adds a mesh, vertices of shape (n, 3) [m], triangles of shape (m, 3), to the model's assets."""
    ET.SubElement(
        asset, "mesh", name=name, vertex=numbers(vertices.ravel()), face=" ".join(map(str, triangles.ravel()))
    )


ARM_STIFFNESS = (10000.0, 10000.0, 10000.0, 10000.0, 6000.0, 6000.0, 6000.0)
"""Of the arm's gears [Nm/rad], of the published order for such arms, 6000 to 15000."""
ARM_DAMPING = (100.0, 100.0, 60.0, 60.0, 15.0, 15.0, 15.0)
"""Of the arm's gears [Nm s/rad]: a blow decays within one or two oscillations."""


def add_robot(root: ET.Element, world: ET.Element, urdf: str, T_world_base: np.ndarray, visuals: bool) -> None:
    """Adds the robot of a URDF's text, with or without visual shapes, to the world body; the assets of the model `root`
    take the meshes. `T_world_base`: pose of the base, shape (4, 4). Raises ValueError if the URDF is not a tree, or has
    an unsupported shape."""
    description = ET.fromstring(urdf)
    links = {attribute(link, "name"): link for link in description.findall("link")}
    waiting = description.findall("joint")
    bodies = {BASE: body(world, BASE, T_world_base)}
    while waiting:
        ready = [joint for joint in waiting if _parent(joint) in bodies]
        if not ready:
            raise ValueError(f"Not all links of the robot description are connected to {BASE}.")
        for joint in ready:
            name = attribute(child(joint, "child"), "link")
            bodies[name] = body(bodies[_parent(joint)], name, _origin(joint))
            _add_joint(bodies[name], joint)
            waiting.remove(joint)
    for name, element in bodies.items():
        _add_link(element, name, links[name])
        for i, visual in enumerate(links[name].findall("visual") if visuals else ()):
            _add_visual(root, element, f"{name}/visual_{i}", visual)


NAMED = ("name", "body1", "body2", "joint", "tendon")  # attributes with names of a robot's parts
SECTIONS = ("contact", "tendon", "actuator")


def merge_robot(root: ET.Element, part: ET.Element, prefix: str, number: int, count: int) -> None:
    """Moves a robot that stands alone in the model `part` into the model `root`, which has other things. Its names get
    the prefix, as left/kuka/joint_1; meshes are shared. The robot with this `number`, of so many, touches the others;
    an only one is as in `part`."""
    # Bit of the first of several robots, the next ones follow: the parts of each touch those of the others.
    first_of_several = 8
    world, asset = child(root, "worldbody"), child(root, "asset")
    for mesh in child(part, "asset"):
        if asset.find(f"mesh[@name='{mesh.get('name')}']") is None:
            asset.append(mesh)
    child(root, "option").attrib.update(child(part, "option").attrib)
    moved = list(child(part, "worldbody"))
    for element in moved:
        world.append(element)
    for name in SECTIONS:
        found = part.find(name)
        if found is not None:
            section = root.find(name)
            section = ET.SubElement(root, name) if section is None else section
            section.extend(found)
            moved += found
    for element in (inner for outer in moved for inner in outer.iter()):
        if prefix:
            for key in NAMED:
                if key in element.attrib:
                    element.set(key, f"{prefix}/{element.get(key)}")
        if count > 1 and element.tag == "geom" and element.get("contype") != "0":
            own, others = first_of_several << number, sum(first_of_several << i for i in range(count) if i != number)
            element.set("contype", str(int(attribute(element, "contype")) | own))
            element.set("conaffinity", str(int(attribute(element, "conaffinity")) | others))


def _parent(joint: ET.Element) -> str:
    return attribute(child(joint, "parent"), "link")


def _add_joint(element: ET.Element, joint: ET.Element) -> None:
    arm_armature = 0.1  # inertia added to each joint [kg m^2] for numerical stability
    hand_armature = 0.0001
    if joint.get("type") == "fixed":
        return
    name, limit, axis = attribute(joint, "name"), child(joint, "limit"), attribute(child(joint, "axis"), "xyz")
    if name in JOINTS:
        effort = attribute(limit, "effort")
        drive = {"damping": str(ARM_DAMPING[JOINTS.index(name)]), "armature": str(arm_armature)}
        drive["actuatorfrcrange"] = f"-{effort} {effort}"
    else:
        drive = {"range": f"{attribute(limit, 'lower')} {attribute(limit, 'upper')}", "armature": str(hand_armature)}
    ET.SubElement(element, "joint", {"name": name, "axis": axis, **drive})


def _add_link(element: ET.Element, name: str, link: ET.Element) -> None:
    robot_friction = 0.7
    inertial = link.find("inertial")
    if inertial is not None:
        inertia = child(inertial, "inertia")
        entries = " ".join(attribute(inertia, key) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        position, mass = attribute(child(inertial, "origin"), "xyz"), attribute(child(inertial, "mass"), "value")
        ET.SubElement(element, "inertial", pos=position, mass=mass, fullinertia=entries)
    for i, collision in enumerate(link.findall("collision")):
        _add_plain(element, f"{name}/collision_{i}", ROBOT, collision, friction=robot_friction)


def _add_visual(root: ET.Element, element: ET.Element, name: str, visual: ET.Element) -> None:
    mesh = visual.find("geometry/mesh")
    if mesh is None:
        _add_plain(element, name, VISUAL, visual, colour=_numbers(child(visual, "material/color"), "rgba")[:3])
        return
    file = attribute(mesh, "filename")
    vertices, triangles, colour = surface_from_collada(read_mesh(file))
    asset, T = child(root, "asset"), _origin(visual)
    label = file.partition("meshes/")[2]
    if asset.find(f"mesh[@name='{label}']") is None:
        add_mesh(asset, label, vertices * np.array(mesh.get("scale", "1 1 1").split(), dtype=float), triangles)
    geom(element, name, VISUAL, "mesh", None, p=T[:3, 3], R=T[:3, :3], colour=colour, mesh=label)


def _add_plain(
    element: ET.Element,
    name: str,
    touch: Touch,
    shape: ET.Element,
    friction: float | None = None,
    colour: Iterable[float] | None = None,
) -> None:
    T = _origin(shape)
    box, cylinder = shape.find("geometry/box"), shape.find("geometry/cylinder")
    if box is not None:
        kind, size = "box", _numbers(box, "size") / 2.0
    elif cylinder is not None:
        radius, length = float(attribute(cylinder, "radius")), float(attribute(cylinder, "length"))
        kind, size = "cylinder", np.array([radius, length / 2.0])
    else:
        raise ValueError(f"The shape {name} is neither a box nor a cylinder.")
    geom(element, name, touch, kind, size, p=T[:3, 3], R=T[:3, :3], friction=friction, colour=colour)


def _origin(element: ET.Element) -> np.ndarray:
    origin = child(element, "origin")
    roll, pitch, yaw = _numbers(origin, "rpy")
    return pose(rotation_from_zyx(yaw, pitch, roll), _numbers(origin, "xyz"))


def _numbers(element: ET.Element, name: str) -> np.ndarray:
    return np.array(attribute(element, name).split(), dtype=float)
