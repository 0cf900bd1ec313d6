"""The ReFlex TakkTile hand in numbers: joints, limits, masses. Lengths in m, angles in rad.

The hand's frame lies in the centre of its mounting face, z out of the palm, x towards the two fingers; finger 3 is the
thumb. Proximal 0 is a finger flat outwards, pi/2 one that stands up, pi one folded over the palm. The flexure between
the finger's links is modelled as one joint at the place where the straight finger's distal frame lies.

Sources: frames and dimensions from the vendor's visual model; mass about 0.9 kg as measured, split over the parts, and
the ranges of preshape and flexure (two joints of pi/6, each) from simulators of the hand's users. Speed and torque are
those of the servo behind each tendon.

The printed ring of the marker board (cad/marker_connector) goes between flange and connector; while it is on, the hand
stands farther from the flange by its length."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from rig_description.rigid_body import Body, box, cylinder, joined, turned

CONNECTOR_LENGTH = 0.026
"""From the media flange's face to the hand's mounting face."""
CONNECTOR_YAW = np.pi
"""The hand is turned by half a turn about the flange's axis: in the calculated home position the tool's x axis points
back to the base, and so the two fingers point away from it, like those of the operator behind the Leap."""
CONNECTOR_RADIUS = 0.043
"""Outer radius of the printed connectors (cad/dimensions.py)."""
CONNECTOR_FACES = np.array([0.0, 0.0, -CONNECTOR_LENGTH]), np.zeros(3)
"""Centres of the connector's faces in the hand's frame."""
TENDON_SPEED, TENDON_TORQUE = 3.5, 2.5
PRESHAPE_MAX, PROXIMAL_MAX, DISTAL_MAX = 1.75, pi, pi / 3


@dataclass(frozen=True)
class HandJoint:
    """One joint of the hand."""

    # Without the prefix `reflex/`
    name: str
    parent: str
    child: str
    xyz: tuple[float, float, float]  # origin in the parent [m], shape (3,)
    yaw: float  # turn of the child about the parent's z [rad]
    axis: tuple[int, int, int]  # shape (3,)
    limits: tuple[float, float]  # lower, upper [rad]


DOWN, RIGHT = (0, 0, -1), (0, -1, 0)

# The second preshape joint turns against the first: its value is the negative of the motor's.
JOINTS = (
    HandJoint("preshape_1", "base_link", "swivel_1", (0.0504, -0.026, 0.063), 0.0, DOWN, (0.0, PRESHAPE_MAX)),
    HandJoint("preshape_2", "base_link", "swivel_2", (0.0504, 0.026, 0.063), 0.0, DOWN, (-PRESHAPE_MAX, 0.0)),
    HandJoint("proximal_joint_1", "swivel_1", "proximal_1", (0.010, 0, 0.0186), 0.0, RIGHT, (0.0, PROXIMAL_MAX)),
    HandJoint("proximal_joint_2", "swivel_2", "proximal_2", (0.010, 0, 0.0186), 0.0, RIGHT, (0.0, PROXIMAL_MAX)),
    HandJoint("proximal_joint_3", "base_link", "proximal_3", (-0.030, 0, 0.0816), pi, RIGHT, (0.0, PROXIMAL_MAX)),
    HandJoint("distal_joint_1", "proximal_1", "distal_1", (0.066, 0, 0.004), 0.0, RIGHT, (0.0, DISTAL_MAX)),
    HandJoint("distal_joint_2", "proximal_2", "distal_2", (0.066, 0, 0.004), 0.0, RIGHT, (0.0, DISTAL_MAX)),
    HandJoint("distal_joint_3", "proximal_3", "distal_3", (0.066, 0, 0.004), 0.0, RIGHT, (0.0, DISTAL_MAX)),
)
FINGER_REACH = 0.132
"""From the knuckle at preshape 0 to the tip of a straight finger at any preshape."""
LINKS = ("base_link", *(joint.child for joint in JOINTS))
EXTENT = {
    "base_link": ((-0.055, -0.053, 0.0), (0.083, 0.053, 0.090)),
    "swivel": ((-0.018, -0.018, 0.0), (0.021, 0.018, 0.0296)),
    "proximal": ((-0.011, -0.008, -0.008), (0.062, 0.008, 0.014)),
    "distal": ((0.0, -0.008, -0.008), (0.048, 0.008, 0.010)),
}
"""Opposite corners of the box around each part, in its frame, by the link's name without its number."""
_TIP_TILT_RAD = np.radians(30.0)
TAXEL_POSITIONS = {
    "proximal": np.array([(x, 0.0, 0.0154) for x in (0.0189, 0.0268, 0.0347, 0.0426, 0.0506)]),
    "distal": np.array([(0.0114, 0.0, 0.0129), (0.0193, 0.0, 0.0129), (0.0272, 0.0, 0.0129), (0.0375, 0.0, 0.0073)]),
}
_UP = (0.0, 0.0, 1.0)
_TIP_NORMAL = (np.sin(_TIP_TILT_RAD), 0.0, np.cos(_TIP_TILT_RAD))
TAXEL_NORMALS = {"proximal": np.array([_UP] * 5), "distal": np.array([_UP] * 3 + [_TIP_NORMAL])}
"""Where each taxel is on a part, in its frame, and which way it faces, shape (n, 3): five on the proximal part from
its base outwards, four on the distal one, the last at the finger tip."""
_MASSES = {"base_link": 0.63, "swivel": 0.02, "proximal": 0.04, "distal": 0.05}


def part(link: str) -> str:
    """Returns the link's name without its number: three links share each part."""
    return link if link == "base_link" else link.rsplit("_", 1)[0]


def body(link: str) -> Body:
    """Returns the mass properties of a link in its frame; the base carries the connector."""
    connector_mass = 0.18
    solid = box(_MASSES[part(link)], *EXTENT[part(link)])
    connector = cylinder(connector_mass, CONNECTOR_RADIUS, *CONNECTOR_FACES)
    return joined([solid, connector]) if link == "base_link" else solid


def tool_body(distance: float = CONNECTOR_LENGTH) -> Body:
    """Returns connector and hand with the joints at zero as one, in the flange's frame; `distance` is that of the
    hand's frame from the flange [m]."""
    yaws, origins = {"base_link": CONNECTOR_YAW}, {"base_link": np.array([0.0, 0.0, distance])}
    for joint in JOINTS:
        yaw, origin = yaws[joint.parent], origins[joint.parent]
        yaws[joint.child], origins[joint.child] = yaw + joint.yaw, origin + _about_z(yaw) @ joint.xyz
    parts = ((turned(body(link), _about_z(yaws[link])), origins[link]) for link in LINKS)
    return joined([Body(part.mass, part.com + origin, part.inertia) for part, origin in parts])


def finger_balls(distance: float = CONNECTOR_LENGTH) -> tuple[tuple[float, float, float, float], ...]:
    """Returns the balls that the fingers leave at no opening: centre in the flange, x, y, z [m], and radius [m].
    `distance`: of the hand's frame from the flange [m]."""
    origins = {"base_link": np.array([0.0, 0.0, distance])}
    for joint in JOINTS:
        origins[joint.child] = origins[joint.parent] + _about_z(CONNECTOR_YAW) @ joint.xyz
    return tuple((*origins[f"proximal_{finger}"].tolist(), FINGER_REACH) for finger in (1, 2, 3))


def _about_z(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])


RING_LENGTH = 0.010
RING_FACES = np.zeros(3), np.array([0.0, 0.0, RING_LENGTH])
"""Centres of the faces of the round part."""
RING_PAD_FACE = 0.061
RING_PAD = (-0.058, 0.053, 0.0), (0.058, RING_PAD_FACE, 0.060)
RING_ARM = (-0.035, 0.025, 0.0), (0.035, 0.053, RING_LENGTH)
"""Opposite corners of the pad, and of what holds it."""


def ring_body() -> Body:
    """Returns its mass properties in the flange's frame."""
    # Of ring, pad and arm [kg]: 118 cm^3 of PETG, as if solid.
    ring_masses = (0.065, 0.075, 0.010)
    ring, pad, arm = ring_masses
    return joined([cylinder(ring, CONNECTOR_RADIUS, *RING_FACES), box(pad, *RING_PAD), box(arm, *RING_ARM)])
