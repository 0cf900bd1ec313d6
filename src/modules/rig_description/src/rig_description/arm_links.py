"""Frames, plain shapes and mass properties of the arm's links.

A link's frame is its frame of the modified Denavit-Hartenberg table, but for link 7, whose frame stays at the wrist:
the 0.126 m to the arm's flange and the media flange follow as a fixed joint.
"""

from __future__ import annotations

import numpy as np

from rig_description.arms import ALPHA_DEG, WRIST_TO_FLANGE, ArmDescription
from rig_description.rigid_body import Body, cylinder, turned


def rotation_x(degrees: int) -> np.ndarray:
    """Returns the rotation about x by a multiple of 90 deg, shape (3, 3); the numbers are exact."""
    c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[degrees // 90 % 4]
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def upright(link: int) -> np.ndarray:
    """Returns the orientation of link 0 to 7 in the base, shape (3, 3), when all joints are zero: the arm stands up."""
    return rotation_x(sum(ALPHA_DEG[:link]))


def origin_in_parent(arm: ArmDescription, link: int) -> np.ndarray:
    """Returns the origin of link 1 to 7 in the frame of the link before [m], shape (3,)."""
    along = {1: arm.lengths[0], 3: arm.lengths[1], 5: arm.lengths[2]}.get(link, 0.0)
    return rotation_x(ALPHA_DEG[link - 1]) @ np.array([0.0, 0.0, along])


def tube(arm: ArmDescription, link: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Returns radius and the centres of both faces [m] of the cylinder nearest to link 0 to 7, in the link's frame.

    Links 1 to 5 alternate: each stands between a seam across the arm and the half of a joint's housing beside the
    arm's axis. The cylinder is the shape for collisions, and the solid whose inertia stands in for unusable data.
    """
    shoulder, upper, fore = arm.lengths
    low, middle, high = arm.seams
    radius, bottom, top = (
        (0.100, (0, 0, 0), (0, 0, low)),
        (0.085, (0, -0.02, low - shoulder), (0, -0.04, 0.085)),
        (0.085, (0, 0.04, -0.085), (0, 0.02, middle)),
        (0.085, (0, 0.02, middle - upper), (0, 0.04, 0.085)),
        (0.080, (0, -0.04, -0.080), (0, -0.02, high)),
        (0.072, (0, -0.01, high - fore), (0, -0.045, 0.0)),
        (0.070, (0, 0, -0.070), (0, 0, 0.078)),
        (0.048, (0, 0, 0.078), (0, 0, WRIST_TO_FLANGE)),
    )[link]
    R = upright(link).T
    return radius, R @ np.array(bottom, dtype=float), R @ np.array(top, dtype=float)


def body(arm: ArmDescription, link: int) -> Body:
    """Returns the mass properties of link 0 to 7 in its frame.

    The base gets what the data sheet's weight leaves for it. Where the published numbers of a link are unusable, the
    mass stays and is spread evenly over the link's plain shape.
    """
    if link == 0:
        rest = arm.mass - sum(body(arm, other).mass for other in range(1, 8))
        return cylinder(rest, *tube(arm, 0))
    if link in arm.unusable:
        return cylinder(arm.masses.get(link, arm.dynamics.m[link - 1]), *tube(arm, link))
    return published(arm, link)


def published(arm: ArmDescription, link: int) -> Body:
    """Returns the published mass properties of link 1 to 7, usable or not, in the link's frame."""
    i = link - 1
    xx, yy, zz, xy, yz, xz = (row[i] for row in arm.dynamics.moments)
    com = np.array([row[i] for row in arm.dynamics.c])
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    R_link_table = rotation_x((*ALPHA_DEG, 0)[link]) if arm.twisted else np.diag([-1.0, -1.0, 1.0])
    return turned(Body(arm.dynamics.m[i], com, inertia), R_link_table)
