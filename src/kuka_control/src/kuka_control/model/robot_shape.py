"""The robot as convex bodies that enclose it: links, media flange, marker board, and the ReFlex hand at any opening.
Numbers of the meshes and solids in rig_description. The axes of a link are those of the base while all joints are
zero; its origin is the shoulder (links 1 and 2), the elbow (3 and 4) or the wrist (5 to 7). Lengths in m, angles in
rad."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import numpy as np

from common.poses import pose, read_only, translation
from common.rotations import rotation_about
from iiwa_kinematics import Ball, RobotModel
from kuka_control.model.obstacles import ConvexBody, ConvexShape
from rig_description import arms, hand
from rig_description.urdf import TABLE_HALF, TABLE_THICKNESS

TABLE = "table"


@dataclass(frozen=True)
class Opening:
    """Joints of the hand as its state topic has them: fingers index, middle, thumb [rad]."""

    proximal: tuple[float, float, float]
    distal: tuple[float, float, float]
    preshape: float

    @property
    def joints(self) -> tuple[float, ...]:
        return (*self.proximal, *self.distal, self.preshape)

    def differs(self, before: Opening) -> bool:
        """Returns whether the hand has opened or closed since `before` so far that bodies must be placed anew."""
        turned = 0.02  # some joint, by more than this [rad]
        return any(abs(now - then) > turned for now, then in zip(self.joints, before.joints))


def arm_bodies(model: RobotModel, ring: bool) -> list[ConvexBody]:
    """Returns the bodies of base, links 1 to 6, and link 7 with media flange, the hand's connector, and any ring."""
    # Of links 1 to 4: radius of the capsule around each, how far before the link's seam it ends, and how far beside
    # the axis in the half of the joint's housing.
    elbow_radius = 0.089
    elbow_end = 0.055
    elbow_aside = 0.0465
    forearm_radius = 0.081
    forearm_end = 0.042
    forearm_aside = 0.040
    wrist_radius = 0.080
    flange_radius = 0.0505
    link_7 = 0.075  # where link 7 begins beyond the wrist
    base_radius = 0.113
    plugs = ((-0.143, -0.066, 0.0), (-0.02, 0.066, 0.093))
    low, middle, high = arms.ARMS[model.name].seams
    shoulder, upper, fore = model.base_shoulder, model.shoulder_elbow, model.elbow_wrist
    r, end, aside = elbow_radius, elbow_end, elbow_aside
    top = model.wrist_flange + hand.CONNECTOR_LENGTH + ring * hand.RING_LENGTH
    corners = np.array([*hand.RING_PAD, *hand.RING_ARM])
    pad = _box("marker ring", 7, corners.min(axis=0), corners.max(axis=0), translation(0.0, 0.0, model.wrist_flange))
    bodies = [
        ConvexBody("base", 0, ConvexShape("cylinder", (base_radius, low)), read_only(translation(0.0, 0.0, low / 2.0))),
        _box("base plugs", 0, *plugs),
        _capsule("link 1", 1, r, (0.0, 0.0, low - shoulder + end), (0.0, -aside, 0.0)),
        _capsule("link 2", 2, r, (0.0, aside, 0.0), (0.0, 0.0, middle - end)),
        _capsule("link 3", 3, r, (0.0, 0.0, middle - upper + end), (0.0, aside, 0.0)),
        _capsule("link 4", 4, r, (0.0, -aside, 0.0), (0.0, 0.0, high - end)),
        _capsule("link 5", 5, forearm_radius, (0.0, 0.0, high - fore + forearm_end), (0.0, -forearm_aside, 0.0)),
        _capsule("link 6", 6, wrist_radius, (0.0, 0.0015, 0.0155), (0.0, 0.0105, 0.0)),
        ConvexBody(
            "flange",
            7,
            ConvexShape("cylinder", (flange_radius, top - link_7)),
            read_only(translation(0, 0, (top + link_7) / 2)),
        ),
    ]
    return [*bodies, pad] if ring else bodies


def table() -> ConvexBody:
    """Returns the board under the base."""
    half, thick = TABLE_HALF, TABLE_THICKNESS
    return _box(TABLE, 0, (-half, -half, -thick), (half, half, 0.0))


def hand_bodies(model: RobotModel, ring: bool, opening: Opening | None) -> list[ConvexBody]:
    """Returns the palm and the fingers; `ring`: the ring of the marker board is behind the hand. Each finger is the
    sphere that it does not leave, whatever moves it; at an `opening` it is two capsules."""
    palm = (-0.064, -0.056, 0.0), (0.084, 0.056, 0.094)  # opposite corners, with the swivels of the fingers
    phalanx_radius = 0.0165
    proximal = ((0.0, 0.003), (0.054, 0.003))  # x, z of the ends of their axes
    distal = ((0.003, 0.001), (0.038, 0.001))
    T_7_hand = translation(0.0, 0.0, model.wrist_flange + hand.CONNECTOR_LENGTH + ring * hand.RING_LENGTH)
    T_7_hand[:3, :3] = rotation_about(2, hand.CONNECTOR_YAW)
    bodies = [_box("palm", 7, *palm, T_7_hand)]
    frames = {"base_link": T_7_hand}
    for joint in hand.JOINTS:
        T = pose(rotation_about(2, joint.yaw), joint.xyz)
        if opening is not None:
            axis = 2 if joint.axis == hand.DOWN else 1
            T[:3, :3] = T[:3, :3] @ rotation_about(axis, -_angle(joint.name, opening))
        frames[joint.child] = frames[joint.parent] @ T
    for finger in (1, 2, 3):
        if opening is None:
            T, sphere = pose(p=frames[f"proximal_{finger}"][:3, 3]), ConvexShape("sphere", (hand.FINGER_REACH,))
            bodies.append(ConvexBody(f"reach of finger {finger}", 7, sphere, T, True))
            continue
        for part, ends in (("proximal", proximal), ("distal", distal)):
            a, b = ((x, 0.0, z) for x, z in ends)
            T = frames[f"{part}_{finger}"]
            bodies.append(_capsule(f"finger {finger}, {part}", 7, phalanx_radius, a, b, T, True))
    return bodies


def finger_tips(model: RobotModel, ring: bool, opening: Opening | None) -> tuple[Ball, ...]:
    """Returns the tip of each finger as a ball in the flange; without an opening, where the finger may be."""
    if opening is None:
        return hand.finger_balls(hand.CONNECTOR_LENGTH + ring * hand.RING_LENGTH)
    distal = (body for body in hand_bodies(model, ring, opening) if body.name.endswith("distal"))
    return tuple(_ball(body, 0.5 * body.shape.size[1], body.shape.size[0], model) for body in distal)


def enclosing_ball(body: ConvexBody, model: RobotModel) -> Ball:
    """Returns a ball in the flange that encloses a body of link 7."""
    return _ball(body, 0.0, body.shape.radius, model)


def _ball(body: ConvexBody, along: float, radius: float, model: RobotModel) -> Ball:
    """Returns a ball about a point on the axis z of a body of link 7."""
    x, y, z = (body.T_link_body[:3, 3] + along * body.T_link_body[:3, 2]).tolist()
    return x, y, z - model.wrist_flange, radius


def _angle(joint: str, opening: Opening) -> float:
    """Returns the angle of a joint of the hand; the second preshape joint turns against the first."""
    kind, finger = joint.split("_")[0], int(joint[-1]) - 1
    if kind == "preshape":
        return opening.preshape if finger == 0 else -opening.preshape
    angle = (opening.proximal if kind == "proximal" else opening.distal)[finger]
    return min(max(angle, 0.0), pi if kind == "proximal" else hand.DISTAL_MAX)


def _box(
    name: str, link: int, low: Iterable[float], high: Iterable[float], T_link: np.ndarray | None = None
) -> ConvexBody:
    low, high = np.array(list(low)), np.array(list(high))
    T = translation(*((low + high) / 2.0))
    return ConvexBody(
        name, link, ConvexShape("box", tuple((high - low).tolist())), read_only(T if T_link is None else T_link @ T)
    )


def _capsule(
    name: str,
    link: int,
    radius: float,
    start: Iterable[float],
    end: Iterable[float],
    T_link: np.ndarray | None = None,
    finger: bool = False,
) -> ConvexBody:
    a, b = np.array(list(start)), np.array(list(end))
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length
    x = np.cross((0.0, 1.0, 0.0) if abs(z[1]) < 0.9 else (0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    T = pose(np.column_stack([x, np.cross(z, x), z]), (a + b) / 2.0)
    shape = ConvexShape("capsule", (radius, length))
    return ConvexBody(name, link, shape, read_only(T if T_link is None else T_link @ T), finger)
