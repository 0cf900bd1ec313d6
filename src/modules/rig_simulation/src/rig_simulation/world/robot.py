"""The arm and the hand as bodies of the physics, with frames, masses, shapes and names of their URDF.

Contacts use the collision shapes of the URDF; arm and hand do not touch each other. Meshes are visual only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from xml.etree import ElementTree as ET

import numpy as np

from common.frames import BASE
from common.poses import pose
from common.rotations import rotation_from_zyx
from rig_simulation.devices.sunrise.robot import JOINTS
from rig_simulation.world.meshes import TriangleSurface
from rig_simulation.world.mjcf import ROBOT, VISUAL, Touch, attribute, body, child, geom, numbers

ROBOT_FRICTION = 0.7
ARM_STIFFNESS = (10000.0, 10000.0, 10000.0, 10000.0, 6000.0, 6000.0, 6000.0)
"""Of the arm's gears [Nm/rad], of the published order for such arms, 6000 to 15000."""
ARM_DAMPING = (100.0, 100.0, 60.0, 60.0, 15.0, 15.0, 15.0)
"""Of the arm's gears [Nm s/rad]: a blow decays within one or two oscillations."""
ARM_ARMATURE, HAND_ARMATURE = 0.1, 0.0001
"""Inertia added to each joint [kg m^2] for numerical stability."""


def add_robot(
    root: ET.Element,
    world: ET.Element,
    urdf: str,
    R_world_base: np.ndarray,
    read: Callable[[str], TriangleSurface] | None,
) -> None:
    """Adds the robot of a URDF.

    Args:
        root: the model, whose assets take the meshes.
        world: its world body.
        urdf: text of the description.
        R_world_base: orientation of the base, shape (3, 3).
        read: returns the surface of a mesh by its URI; None leaves out visual shapes.

    Raises:
        ValueError: the URDF is not a tree, or has an unsupported shape.
    """
    description = ET.fromstring(urdf)
    links = {attribute(link, "name"): link for link in description.findall("link")}
    joints = description.findall("joint")
    bodies = {BASE: body(world, BASE, pose(R_world_base))}
    waiting = list(joints)
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
        _add_link(root, element, links[name], read)


def _parent(joint: ET.Element) -> str:
    """Returns the name of a joint's parent link."""
    return attribute(child(joint, "parent"), "link")


def _add_joint(element: ET.Element, joint: ET.Element) -> None:
    if joint.get("type") == "fixed":
        return
    name, limit, axis = attribute(joint, "name"), child(joint, "limit"), attribute(child(joint, "axis"), "xyz")
    if name in JOINTS:
        drive = {"damping": str(ARM_DAMPING[JOINTS.index(name)]), "armature": str(ARM_ARMATURE)}
        effort = attribute(limit, "effort")
        drive["actuatorfrcrange"] = f"-{effort} {effort}"
    else:
        drive = {"range": f"{attribute(limit, 'lower')} {attribute(limit, 'upper')}", "armature": str(HAND_ARMATURE)}
    ET.SubElement(element, "joint", {"name": name, "axis": axis, **drive})


def _add_link(
    root: ET.Element, element: ET.Element, link: ET.Element, read: Callable[[str], TriangleSurface] | None
) -> None:
    inertial = link.find("inertial")
    if inertial is not None:
        inertia = child(inertial, "inertia")
        entries = " ".join(attribute(inertia, key) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
        position, mass = attribute(child(inertial, "origin"), "xyz"), attribute(child(inertial, "mass"), "value")
        ET.SubElement(element, "inertial", pos=position, mass=mass, fullinertia=entries)
    name = attribute(link, "name")
    for i, collision in enumerate(link.findall("collision")):
        _plain(element, f"{name}/collision_{i}", ROBOT, collision, friction=ROBOT_FRICTION)
    if read is None:
        return
    for i, visual in enumerate(link.findall("visual")):
        mesh = visual.find("geometry/mesh")
        if mesh is None:
            colour = [float(value) for value in attribute(child(visual, "material/color"), "rgba").split()[:3]]
            _plain(element, f"{name}/visual_{i}", VISUAL, visual, colour=colour)
        else:
            _mesh(root, element, f"{name}/visual_{i}", visual, mesh, read)


def _plain(
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
        kind, size = "box", np.array(attribute(box, "size").split(), dtype=float) / 2.0
    elif cylinder is not None:
        radius, length = float(attribute(cylinder, "radius")), float(attribute(cylinder, "length"))
        kind, size = "cylinder", np.array([radius, length / 2.0])
    else:
        raise ValueError(f"The shape {name} is neither a box nor a cylinder.")
    geom(element, name, touch, kind, size, p=T[:3, 3], R=T[:3, :3], friction=friction, colour=colour)


def _mesh(
    root: ET.Element,
    element: ET.Element,
    name: str,
    visual: ET.Element,
    mesh: ET.Element,
    read: Callable[[str], TriangleSurface],
) -> None:
    file = attribute(mesh, "filename")
    surface = read(file)
    asset, T = child(root, "asset"), _origin(visual)
    label = file.partition("meshes/")[2]
    if asset.find(f"mesh[@name='{label}']") is None:
        scale = np.array(mesh.get("scale", "1 1 1").split(), dtype=float)
        add_mesh(asset, label, surface.vertices * scale, surface.triangles)
    geom(element, name, VISUAL, "mesh", None, p=T[:3, 3], R=T[:3, :3], colour=surface.colour, more={"mesh": label})


def add_mesh(asset: ET.Element, name: str, vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Adds a mesh, vertices of shape (n, 3) [m], triangles of shape (m, 3), to the model's assets."""
    faces = " ".join(str(index) for index in triangles.ravel())
    ET.SubElement(asset, "mesh", name=name, vertex=numbers(vertices.ravel()), face=faces)


def _origin(element: ET.Element) -> np.ndarray:
    origin = child(element, "origin")
    roll, pitch, yaw = (float(value) for value in attribute(origin, "rpy").split())
    return pose(rotation_from_zyx(yaw, pitch, roll), [float(value) for value in attribute(origin, "xyz").split()])
