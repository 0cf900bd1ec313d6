"""Masses, torques and shapes of the two arms; lengths, ranges and speeds are those of iiwa_kinematics. Lengths in m.

Sources: dynamics from the client of the KUKA Sunrise Toolbox, torques from KUKA's data sheets (LBR iiwa 7 R800, LBR
iiwa 14 R820). The torques of the 7 R800 are quoted second-hand: check them against the data sheet before anything
relies on them.

A link's frame is its frame of the modified Denavit-Hartenberg table, but for link 7, whose frame stays at the wrist:
the 0.126 m to the arm's flange and the media flange follow as a fixed joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iiwa_kinematics.robot_model import WRIST_LINK_7, RobotModel, robot_model
from rig_description.rigid_body import Body, cylinder, turned

ALPHA_DEG = (0, -90, 90, 90, -90, -90, 90)
"""Turn of joint i's axis about the x axis of the frame before: modified Denavit-Hartenberg (Craig), all a = 0."""
MEDIA_FLANGE_RADIUS = 0.050
MEDIA_FLANGE_DENSITY = 1350.0
"""No source gives a mass: half the density of aluminium [kg m^-3], for a part that is half hollow."""


@dataclass(frozen=True)
class Dynamics:
    """Published masses of links 1 to 7, each a row of seven, in frames of the publication's own."""

    m: tuple[float, ...]  # masses [kg]
    c: tuple[tuple[float, ...], ...]  # centres of mass x, y, z [m]
    moments: tuple[tuple[float, ...], ...]  # xx, yy, zz, xy, yz, xz about the centre of mass [kg m^2]


@dataclass(frozen=True)
class ArmDescription:
    """One type of arm."""

    model: RobotModel  # lengths, ranges, speeds
    # Height of the seam of links 0 and 1 above the base, and how far beyond the shoulder and the elbow the seams at
    # joints 3 and 5 lie [m]; they shape the links and have no influence on the motion
    seams: tuple[float, float, float]
    torques: tuple[int, ...]  # [Nm], shape (7,)
    mass: float  # of the whole arm without media flange [kg]
    dynamics: Dynamics  # masses as published
    # The frames of `dynamics` are those of the classic convention, whose axes are turned by the twist of the joint
    # that follows; otherwise they are turned by 180 deg about z, because the publication's twists have the opposite
    # signs. In both cases the published centres of mass lie in the links then, and only then.
    twisted: bool
    unusable: dict[int, str]  # why links (1 to 7) get mass properties of their shape instead of the published ones
    masses: dict[int, float]  # masses that are not the published ones, by link (1 to 7) [kg]

    @property
    def lengths(self) -> tuple[float, float, float]:
        """Base to shoulder, shoulder to elbow, elbow to wrist [m]."""
        return self.model.base_shoulder, self.model.shoulder_elbow, self.model.elbow_wrist


# After Hayat et al., from CAD.
_DYNAMICS_7_R800 = Dynamics(
    m=(3.4525, 3.4821, 4.05623, 3.4822, 2.1633, 2.3466, 3.129),
    c=(
        (0, -0.03441, -0.02, 0, 0, 0.000001, 0.0000237),
        (0.06949, 0, -0.089, -0.034412, 0.14, 0.000485, 0.063866),
        (-0.03423, 0.06733, -0.02906, 0.067329, -0.02137, 0.002115, 0.01464),
    ),
    moments=(
        (0.02183, 0.007703, 0.03204, 0.02178, 0.01287, 0.006509, 0.01464),
        (0.007703, 0.02179, 0.00972, 0.02075, 0.005708, 0.006259, 0.01465),
        (0.02083, 0.00779, 0.03042, 0.007785, 0.01112, 0.004527, 0.002872),
        (-1.18e-8, -4.15e-8, -1.63e-8, 8.34e-8, 4.67e-8, 2.64e-8, 0.0005912),
        (-0.003887, -4.73e-8, 0.006227, -0.003625, -0.003946, 0.00031891, 1.36e-5),
        (-8.0e-9, -0.003626, 4.94e-8, 5.61e-8, 6.22e-8, 7.07e-9, -2.56e-6),
    ),
)

# After Stürz et al. 2017, identified from measured motions.
_DYNAMICS_14_R820 = Dynamics(
    m=(3.9781, 4.50275, 2.4552, 2.61155, 3.41, 3.38795, 0.35432),
    c=(
        (-0.00351, -0.00767, -0.00225, 0.0002, 0.0005, 0.00049, -0.03466),
        (0.00016, 0.16669, -0.03492, -0.05268, -0.00237, 0.02019, -0.02324),
        (-0.03139, -0.00355, -0.02652, 0.03818, -0.21134, -0.0275, 0.07138),
    ),
    moments=(
        (0.00455, 0.00032, 0.00223, 0.03844, 0.00277, 0.0005, 0.00795),
        (0.00454, 0.0001, 0.00219, 0.01144, 0.00284, 0.00281, 0.01089),
        (0.00029, 0.00042, 0.00073, 0.04988, 0.00012, 0.00232, 0.00294),
        (0, 0, -0.00005, 0.00088, -0.00001, -0.00005, 0.00022),
        (0.00001, 0, 0.00007, -0.00111, 0, -0.00004, -0.00029),
        (0, 0, 0.00007, -0.00112, 0.00001, -0.00003, -0.00029),
    ),
)
ARMS = {
    "LBR7R800": ArmDescription(
        model=robot_model("LBR7R800", "MF_elektrisch"),
        seams=(0.150, 0.210, 0.210),
        torques=(176, 176, 110, 110, 110, 40, 40),
        mass=23.9,
        dynamics=_DYNAMICS_7_R800,
        twisted=True,
        unusable={
            2: "the principal moments 0.0041, 0.0114, 0.0218 break the triangle inequality; x and y seem exchanged",
            7: "the centre of mass lies beside the link, and the mass is that of a link with a tool",
        },
        # The same part as on the 14 R820; the other six links and the base then make up the data sheet's weight.
        masses={7: 0.35432},
    ),
    "LBR14R820": ArmDescription(
        model=robot_model("LBR14R820", "MF_elektrisch"),
        seams=(0.1575, 0.2045, 0.1845),
        torques=(320, 320, 176, 176, 110, 40, 40),
        mass=29.9,
        dynamics=_DYNAMICS_14_R820,
        twisted=False,
        unusable={
            2: "the principal moments 0.0001, 0.00032, 0.00042 are those of a plate without thickness, 2 cm wide",
            4: "the principal moments 0.01138, 0.03835, 0.05003 break the triangle inequality",
            7: "the principal moments 0.00291, 0.00795, 0.01092 break the triangle inequality",
        },
        masses={},
    ),
}


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
    Links 1 to 5 alternate: each stands between a seam across the arm and the half of a joint's housing beside the arm's
    axis. The cylinder is the shape for collisions, and the solid whose inertia stands in for unusable data."""
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
        (0.048, (0, 0, 0.078), (0, 0, WRIST_LINK_7)),
    )[link]
    R = upright(link).T
    return radius, R @ np.array(bottom, dtype=float), R @ np.array(top, dtype=float)


def link_body(arm: ArmDescription, link: int) -> Body:
    """Returns the mass properties of link 0 to 7 in its frame. The base gets what the data sheet's weight leaves for
    it. Where the published numbers of a link are unusable, the mass stays and is spread evenly over the link's plain
    shape."""
    if link == 0:
        rest = arm.mass - sum(link_body(arm, other).mass for other in range(1, 8))
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
