"""The ReFlex hand in the physics: springs, tendons and contact shapes, added to the bodies of the URDF.

Each finger is underactuated: one tendon pulls knuckle and flexure with the same lever arm, against a spring in each.
Tendon travel is the turn of both joints together [rad], as in the driver. Without contact the springs divide it
`1 : 0.4`; once the proximal link is blocked, the flexure takes the rest.
The stiffness of the springs is an assumption, since none is published: their ratio follows from a free finger, the
preload holds a level finger against its weight (0.055 Nm), and full closing needs a fifth of the motor's torque.
Lengths in m, angles in rad, in the frames of the URDF."""

from __future__ import annotations

from typing import Any, Tuple
from xml.etree import ElementTree as ET

from rig_simulation.world.mjcf import Touch, child, geom, numbers

FINGERS = (1, 2, 3)
PARTS = ("proximal", "distal")
FLEXURE_RATIO = 0.4  # ratio of the turns of flexure and knuckle of a free finger
FLEXURE_STIFFNESS_NM_RAD = 0.6
KNUCKLE_STIFFNESS_NM_RAD = FLEXURE_RATIO * FLEXURE_STIFFNESS_NM_RAD
_JOINTS = {
    "preshape": (0.0, 0.01, 5e-4),
    "proximal_joint": (KNUCKLE_STIFFNESS_NM_RAD, 0.015, 2e-4),
    "distal_joint": (FLEXURE_STIFFNESS_NM_RAD, 0.006, 1e-4),
}
"""Stiffness [Nm/rad], damping [Nm s/rad], armature [kg m^2]."""
HAND = Touch(kind=5, partners=6, group=3)
"""Touches what the rest of the robot touches, and itself: fingers lie against each other and on the palm."""
# Rubber grips well, is slightly soft, and its contact resists twisting, whatever it touches.
RUBBER_FRICTION = 1.1
_RUBBER: dict[str, Any] = {"condim": "4", "priority": "1", "solref": "0.005 1", "solimp": "0.95 0.99 0.001"}
HOLDING = {"cone": "elliptic", "impratio": "100", "noslip_iterations": "4"}
"""With MuJoCo's defaults a held object creeps out of the hand by about 1 mm/s."""
_PADS = {"proximal": (0.019, 0.054, 0.006), "distal": (0.013, 0.040, 0.002)}
"""First and last point of the middle line along the link, and its height."""
_Corners = Tuple[Tuple[float, float, float], Tuple[float, float, float]]


def pad_name(part: str, finger: int) -> str:
    """Returns the name of the rubber pad on a part of a finger, "proximal" or "distal"."""
    return f"reflex/{part}_{finger}/pad"


def tendon_name(finger: int) -> str:
    """Returns the name of a finger's tendon and of its motor."""
    return f"reflex/tendon_{finger}"


def prepare_hand(root: ET.Element) -> None:
    """Adds the mechanics of the hand to a model with its options and the bodies and joints of the robot's URDF: springs
    and damping of its joints, tendons, motors. Replaces its collision shapes by those of this file, and excludes the
    pairs of links that never touch. Raises KeyError if a body or joint of the hand is missing."""
    shell_friction = 0.5
    palm = ((-0.016, -0.050, 0.066), (0.080, 0.050, 0.089))
    shell = ((-0.055, -0.053, 0.030), (0.083, 0.053, 0.066)), ((-0.055, -0.024, 0.066), (-0.016, 0.024, 0.090))
    beam = ((-0.011, -0.007, -0.008), (0.060, 0.007, 0.004))
    swivel_radius = 0.018
    swivel_height = 0.0296
    bodies = {body.get("name", ""): body for body in root.iter("body")}
    joints = {joint.get("name"): joint for joint in root.iter("joint")}
    for name, body in bodies.items():
        if name.startswith("reflex/"):
            for shape in body.findall("geom"):
                if shape.get("contype") != "0":
                    body.remove(shape)
    base = bodies["reflex/base_link"]
    _box(base, "palm", palm, RUBBER_FRICTION, **_RUBBER)
    for number, corners in enumerate(shell):
        _box(base, f"shell_{number}", corners, shell_friction)
    contact = _section(root, "contact")
    for finger in FINGERS:
        if finger != 3:
            _spring(joints[f"reflex/preshape_{finger}"], "preshape")
            swivel, size, middle = (
                f"reflex/swivel_{finger}",
                (swivel_radius, swivel_height / 2),
                (0, 0, swivel_height / 2),
            )
            geom(bodies[swivel], f"{swivel}/drum", HAND, "cylinder", size, p=middle, friction=shell_friction)
            ET.SubElement(contact, "exclude", body1="reflex/base_link", body2=swivel)
        for kind in ("proximal_joint", "distal_joint"):
            _spring(joints[f"reflex/{kind}_{finger}"], kind)
        _box(bodies[f"reflex/proximal_{finger}"], "beam", beam, shell_friction)
        for part in PARTS:
            _pad(bodies[f"reflex/{part}_{finger}"], part, finger)
        ET.SubElement(contact, "exclude", body1="reflex/base_link", body2=f"reflex/proximal_{finger}")
    _add_motors(_section(root, "tendon"), _section(root, "actuator"))
    child(root, "option").attrib.update(HOLDING)


def _spring(joint: ET.Element, kind: str) -> None:
    preload_nm = 0.08
    stiffness, damping, armature = _JOINTS[kind]
    joint.attrib.update(damping=str(damping), armature=str(armature))
    if stiffness:
        joint.attrib.update(stiffness=str(stiffness), springref=str(-preload_nm / stiffness))


def _box(body: ET.Element, name: str, corners: _Corners, friction: float, **more: Any) -> None:
    middle = [(low + high) / 2 for low, high in zip(*corners)]
    halves = [(high - low) / 2 for low, high in zip(*corners)]
    geom(body, f"{body.get('name')}/{name}", HAND, "box", halves, p=middle, friction=friction, **more)


def _pad(body: ET.Element, part: str, finger: int) -> None:
    pad_radius = 0.008
    first, last, height = _PADS[part]
    capsule = geom(body, pad_name(part, finger), HAND, "capsule", [pad_radius], friction=RUBBER_FRICTION, **_RUBBER)
    del capsule.attrib["pos"]
    capsule.set("fromto", numbers((first, 0, height, last, 0, height)))


def _add_motors(tendons: ET.Element, actuators: ET.Element) -> None:
    """Adds a motor for each tendon, which only pulls, and for each swivel; their control is the spool angle."""
    tendon_stiffness_nm_rad = 15.0
    tendon_damping_nm_s_rad = 0.05
    most_tension_nm = 6.0
    swivel_stiffness_nm_rad = 8.0
    swivel_damping_nm_s_rad = 0.08
    most_swivel_torque_nm = 3.75
    for finger in FINGERS:
        name = tendon_name(finger)
        fixed = ET.SubElement(tendons, "fixed", name=name)
        for kind in ("proximal_joint", "distal_joint"):
            ET.SubElement(fixed, "joint", joint=f"reflex/{kind}_{finger}", coef="1")
        law = _law(tendon_stiffness_nm_rad, tendon_damping_nm_s_rad, 0.0, most_tension_nm)
        ET.SubElement(actuators, "general", {"name": name, "tendon": name, **law})
    for finger in (1, 2):
        name = f"reflex/preshape_{finger}"
        law = _law(swivel_stiffness_nm_rad, swivel_damping_nm_s_rad, -most_swivel_torque_nm, most_swivel_torque_nm)
        ET.SubElement(actuators, "general", {"name": name, "joint": name, **law})


def _law(stiffness: float, damping: float, low: float, high: float) -> dict[str, str]:
    """Returns the attributes of a motor that pulls like a spring with damping, within limits."""
    bias = numbers((0.0, -stiffness, -damping))
    return {"gainprm": str(stiffness), "biastype": "affine", "biasprm": bias, "forcerange": numbers((low, high))}


def _section(root: ET.Element, name: str) -> ET.Element:
    found = root.find(name)
    return ET.SubElement(root, name) if found is None else found
