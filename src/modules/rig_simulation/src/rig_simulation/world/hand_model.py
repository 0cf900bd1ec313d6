"""The ReFlex hand as MuJoCo sees it: springs, tendons, shapes that touch, added to the bodies and joints of the URDF.

Each finger is underactuated: one tendon pulls at the knuckle and at the flexure with the same lever, two springs hold
against it. Tendon travel is counted as the turn of both joints together [rad], as the driver counts it. Free of
contact the springs share the tendon 1 : 0.4; once the proximal link is held, the flexure takes what is left.

The springs' stiffness is an assumption: nothing is published. Their ratio follows from the shares of a free finger, the
preload holds a level finger up against its weight (0.055 Nm), and full closing takes 14 % of the motor's torque, far
from its overload. Lengths in m, angles in rad, in the frames of the URDF.
"""

from __future__ import annotations

from xml.etree import ElementTree as ET

FINGERS = (1, 2, 3)
FLEXURE_SHARE = 0.4
"""Turn of the flexure of a free finger by that of its knuckle."""

FLEXURE_STIFFNESS_NM_RAD = 0.4
KNUCKLE_STIFFNESS_NM_RAD = FLEXURE_SHARE * FLEXURE_STIFFNESS_NM_RAD
PRELOAD_NM = 0.07
TENDON_STIFFNESS_NM_RAD = 15.0
TENDON_DAMPING_NM_S_RAD = 0.05
MOST_TENSION_NM = 6.0
SWIVEL_STIFFNESS_NM_RAD = 8.0
SWIVEL_DAMPING_NM_S_RAD = 0.08
MOST_SWIVEL_TORQUE_NM = 3.7

_JOINTS = {
    # joint: stiffness, damping, armature; rubber flexure, gears of the swivels
    "preshape": (0.0, 0.01, 5e-4),
    "proximal_joint": (KNUCKLE_STIFFNESS_NM_RAD, 0.015, 2e-4),
    "distal_joint": (FLEXURE_STIFFNESS_NM_RAD, 0.006, 1e-4),
}

# Rubber on things: grips well, gives a little, and has a patch of contact that resists twisting.
_RUBBER = {
    "friction": "1.1 0.008 0.0002",
    "condim": "4",
    "priority": "1",
    "solref": "0.01 1",
    "solimp": "0.9 0.97 0.002",
}
_PAD_RADIUS = 0.008
_PAD = {"proximal": (0.019, 0.054, 0.006), "distal": (0.013, 0.040, 0.002)}
"""First and last point of a pad's middle line along the finger, and its height."""

_SHAPES = {
    "base_link": (
        ("box", (-0.016, -0.050, 0.066), (0.080, 0.050, 0.089), _RUBBER),
        ("box", (-0.055, -0.053, 0.030), (0.083, 0.053, 0.066), {}),
        ("box", (-0.055, -0.024, 0.066), (-0.016, 0.024, 0.090), {}),
    ),
    "swivel": (("cylinder", (-0.018, -0.018, 0.0), (0.018, 0.018, 0.0296), {}),),
    "proximal": (("box", (-0.011, -0.007, -0.008), (0.060, 0.007, 0.004), {}),),
    "distal": (),
}
"""Kind, opposite corners of the box around it, attributes, by part of the hand."""

COLLISION_GROUP = "3"


def pad(part: str, finger: int) -> str:
    """Returns the name of the geom that is the rubber of a finger's part "proximal" or "distal"."""
    return f"reflex/{part}_{finger}/pad"


def tendon(finger: int) -> str:
    """Returns the name of a finger's tendon and of the motor that pulls it."""
    return f"reflex/tendon_{finger}"


def prepare_hand(mjcf: ET.Element) -> None:
    """Makes the hand in an MJCF tree work.

    Gives its joints springs and damping, replaces whatever could touch by the shapes of this file (geom group 3), and
    adds tendons, motors and the pairs that never touch. Geoms that cannot touch (contype and conaffinity 0) stay.

    Args:
        mjcf: root of the tree; it holds the bodies and joints of the URDF by their names. Angles are in rad.

    Raises:
        KeyError: a body or joint is missing.
    """
    bodies = {body.get("name"): body for body in mjcf.iter("body")}
    joints = {joint.get("name"): joint for joint in mjcf.iter("joint")}
    for name, body in bodies.items():
        if name.startswith("reflex/"):
            for geom in body.findall("geom"):
                if not (geom.get("contype") == "0" and geom.get("conaffinity") == "0"):
                    body.remove(geom)
    _shape(bodies["reflex/base_link"], "base_link")
    for finger in FINGERS:
        for kind in ("preshape", "proximal_joint", "distal_joint")[finger == 3 :]:
            _spring(joints[f"reflex/{kind}_{finger}"], kind)
        for part in ("swivel", "proximal", "distal")[finger == 3 :]:
            _shape(bodies[f"reflex/{part}_{finger}"], part)
        for part in _PAD:
            _add_pad(bodies[f"reflex/{part}_{finger}"], part, finger)
    _add_motors(mjcf)
    contact = _section(mjcf, "contact")
    for other in ("swivel_1", "swivel_2", "proximal_1", "proximal_2", "proximal_3"):
        ET.SubElement(contact, "exclude", body1="reflex/base_link", body2=f"reflex/{other}")
    for finger in FINGERS:
        ET.SubElement(contact, "exclude", body1=f"reflex/proximal_{finger}", body2=f"reflex/distal_{finger}")


def _spring(joint: ET.Element, kind: str) -> None:
    stiffness, damping, armature = _JOINTS[kind]
    joint.set("damping", str(damping))
    joint.set("armature", str(armature))
    if stiffness:
        joint.set("stiffness", str(stiffness))
        joint.set("springref", str(-PRELOAD_NM / stiffness))


def _shape(body: ET.Element, part: str) -> None:
    for number, (kind, low, high, attributes) in enumerate(_SHAPES[part]):
        middle = [(a + b) / 2 for a, b in zip(low, high)]
        halves = [(b - a) / 2 for a, b in zip(low, high)]
        size = halves if kind == "box" else (halves[0], halves[2])
        name = f"{body.get('name')}/shape_{number}"
        geom = {"name": name, "type": kind, "pos": _text(middle), "size": _text(size), "mass": "0", **attributes}
        ET.SubElement(body, "geom", group=COLLISION_GROUP, **geom)


def _add_pad(body: ET.Element, part: str, finger: int) -> None:
    first, last, height = _PAD[part]
    geom = {"name": pad(part, finger), "fromto": _text((first, 0, height, last, 0, height)), "size": str(_PAD_RADIUS)}
    ET.SubElement(body, "geom", type="capsule", mass="0", group=COLLISION_GROUP, **geom, **_RUBBER)


def _add_motors(mjcf: ET.Element) -> None:
    """Adds a motor for each tendon, which only pulls, and one for each swivel; their control is the spool's angle."""
    tendons, actuators = _section(mjcf, "tendon"), _section(mjcf, "actuator")
    for finger in FINGERS:
        fixed = ET.SubElement(tendons, "fixed", name=tendon(finger))
        for kind in ("proximal_joint", "distal_joint"):
            ET.SubElement(fixed, "joint", joint=f"reflex/{kind}_{finger}", coef="1")
        _motor(actuators, tendon(finger), TENDON_STIFFNESS_NM_RAD, TENDON_DAMPING_NM_S_RAD, (0.0, MOST_TENSION_NM)).set(
            "tendon", tendon(finger)
        )
    limits = (-MOST_SWIVEL_TORQUE_NM, MOST_SWIVEL_TORQUE_NM)
    for finger in (1, 2):
        name = f"reflex/preshape_{finger}"
        _motor(actuators, name, SWIVEL_STIFFNESS_NM_RAD, SWIVEL_DAMPING_NM_S_RAD, limits).set("joint", name)


def _motor(actuators: ET.Element, name: str, stiffness: float, damping: float, limits) -> ET.Element:
    bias = _text((0.0, -stiffness, -damping))
    law = {"gainprm": str(stiffness), "biastype": "affine", "biasprm": bias}
    return ET.SubElement(actuators, "general", name=name, forcelimited="true", forcerange=_text(limits), **law)


def _section(mjcf: ET.Element, name: str) -> ET.Element:
    found = mjcf.find(name)
    return ET.SubElement(mjcf, name) if found is None else found


def _text(numbers) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)
