"""The two arms in numbers: joints, limits, masses. Lengths in m, angles in degrees as the data sheets give them.

A link's frame is its frame of the modified Denavit-Hartenberg table (Craig; all a = 0), but for link 7, whose frame
stays at the wrist: the 0.126 m to the arm's flange and the media flange follow as a fixed joint.

Sources: geometry and dynamics from the client of the KUKA Sunrise Toolbox; ranges, speeds and torques from KUKA's data
sheets (LBR iiwa 7 R800, LBR iiwa 14 R820). The torques of the 7 R800 are quoted second-hand: check them against the
data sheet before anything relies on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig_description.rigid_body import Body, cylinder, fault, turned

ALPHA_DEG = (0, -90, 90, 90, -90, -90, 90)
"""Turn of joint i's axis about the x axis of the frame before."""

RANGE_DEG = (170, 120, 170, 120, 170, 120, 175)
"""Joints turn by plus and minus this."""

WRIST_TO_FLANGE = 0.126
"""From the wrist, where axes 5, 6, 7 meet, to the face of the arm's own flange."""

MEDIA_FLANGES = {
    "MF_elektrisch": 0.035,
    "MF_pneumatisch": 0.035,
    "MF_IO_pneumatisch": 0.035,
    "MF_touch_pneumatisch": 0.061,
}
"""Heights of the media flanges."""

ALUMINIUM = 2700.0
"""Density [kg m^-3] for parts whose mass no source gives; half of it for hollow ones."""


@dataclass(frozen=True)
class Arm:
    """One type of arm.

    Attributes:
        name: as in the parameter kuka/robot.
        lengths: base to shoulder, shoulder to elbow, elbow to wrist [m].
        seams: height of the seam between link_0 and link_1 above the base, and how far beyond the shoulder and the elbow
            the seams at joints 3 and 5 lie [m]; they shape the links and have no influence on the motion.
        speeds_deg: [deg/s], shape (7,).
        torques: [Nm], shape (7,).
        mass: of the whole arm without media flange [kg].
        links: links 1 to 7 in their frames.
        replaced: reason for each link (1 to 7) whose tabled inertia was replaced by that of a solid of its shape.
    """

    name: str
    lengths: tuple[float, float, float]
    seams: tuple[float, float, float]
    speeds_deg: tuple[int, ...]
    torques: tuple[int, ...]
    mass: float
    links: tuple[Body, ...]
    replaced: dict[int, str]


def rotation_x(degrees: float) -> np.ndarray:
    """Returns the rotation about x, shape (3, 3)."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]).round(15)


def upright(link: int) -> np.ndarray:
    """Returns the attitude of link 0 to 7 in the base when all joints are zero: the arm stands straight up."""
    return rotation_x(sum(ALPHA_DEG[:link]))


def link_tube(arm_lengths, seams, link: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Returns radius and the centres of both faces [m] of the cylinder nearest to a link, axes of the upright pose.

    Links 1 to 6 alternate: each stands between a seam across the arm and the half of a joint's housing beside the
    arm's axis. It is the shape for collisions, and the solid whose inertia stands in for unusable data.
    """
    shoulder, upper, fore = arm_lengths
    low, middle, high = seams
    faces = {
        1: (0.085, (0, -0.02, low - shoulder), (0, -0.04, 0.085)),
        2: (0.085, (0, 0.04, -0.085), (0, 0.02, middle)),
        3: (0.085, (0, 0.02, middle - upper), (0, 0.04, 0.085)),
        4: (0.080, (0, -0.04, -0.080), (0, -0.02, high)),
        5: (0.072, (0, -0.01, high - fore), (0, -0.045, 0.0)),
        6: (0.070, (0, 0.0, -0.070), (0, 0.0, 0.081)),
        7: (0.048, (0, 0.0, 0.081), (0, 0.0, WRIST_TO_FLANGE)),
    }
    radius, bottom, top = faces[link]
    return radius, np.array(bottom, dtype=float), np.array(top, dtype=float)


def _links(lengths, seams, columns, R_link_table, estimates) -> tuple[tuple[Body, ...], dict[int, str]]:
    """Turns the columns m, cx, cy, cz, Ixx, Iyy, Izz, Ixy, Iyz, Ixz of a table into links, and replaces the unusable."""
    links, replaced = [], dict(estimates)
    for i, (m, cx, cy, cz, xx, yy, zz, xy, yz, xz) in enumerate(zip(*columns), start=1):
        body = Body(m, np.array([cx, cy, cz]), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
        body = turned(body, R_link_table[i - 1])
        radius, bottom, top = link_tube(lengths, seams, i)
        if i in estimates:
            mass, reason = estimates[i]
            body = turned(cylinder(mass or m, radius, bottom, top), upright(i).T)
            replaced[i] = reason
        elif fault(body):
            solid = turned(cylinder(m, radius, bottom, top), upright(i).T)
            body = Body(m, body.com, solid.inertia)
            replaced[i] = fault(Body(m, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])))
        links.append(body)
    return tuple(links), replaced


# After Hayat et al. (CAD). The numbers make sense only in the frames of the classic convention: same origins, axes
# turned by the twist of the joint that follows.
_LENGTHS_7, _SEAMS_7 = (0.340, 0.400, 0.400), (0.150, 0.210, 0.210)
_LINKS_7, _REPLACED_7 = _links(
    _LENGTHS_7,
    _SEAMS_7,
    (
        (3.4525, 3.4821, 4.05623, 3.4822, 2.1633, 2.3466, 3.129),
        (0, -0.03441, -0.02, 0, 0, 0.000001, 0.0000237),
        (0.06949, 0, -0.089, -0.034412, 0.14, 0.000485, 0.063866),
        (-0.03423, 0.06733, -0.02906, 0.067329, -0.02137, 0.002115, 0.01464),
        (0.02183, 0.007703, 0.03204, 0.02178, 0.01287, 0.006509, 0.01464),
        (0.007703, 0.02179, 0.00972, 0.02075, 0.005708, 0.006259, 0.01465),
        (0.02083, 0.00779, 0.03042, 0.007785, 0.01112, 0.004527, 0.002872),
        (-1.18e-8, -4.15e-8, -1.63e-8, 8.34e-8, 4.67e-8, 2.64e-8, 0.0005912),
        (-0.003887, -4.73e-8, 0.006227, -0.003625, -0.003946, 0.00031891, 1.36e-5),
        (-8.0e-9, -0.003626, 4.94e-8, 5.61e-8, 6.22e-8, 7.07e-9, -2.56e-6),
    ),
    tuple(rotation_x(alpha) for alpha in (*ALPHA_DEG[1:], 0)),
    {
        2: (None, "the moments break the triangle inequality, and the centre of mass lies beside the link's plane"),
        7: (0.35432, "the centre of mass lies outside the link; mass as for the same part of the 14 R820"),
    },
)

# After Stuerz et al. 2017 (identified). Their twists have the opposite sign, which turns each frame by 180 deg about its
# own z; joint angles keep their sign.
_LENGTHS_14, _SEAMS_14 = (0.360, 0.420, 0.400), (0.1575, 0.2045, 0.1845)
_LINKS_14, _REPLACED_14 = _links(
    _LENGTHS_14,
    _SEAMS_14,
    (
        (3.9781, 4.50275, 2.4552, 2.61155, 3.41, 3.38795, 0.35432),
        (-0.00351, -0.00767, -0.00225, 0.0002, 0.0005, 0.00049, -0.03466),
        (0.00016, 0.16669, -0.03492, -0.05268, -0.00237, 0.02019, -0.02324),
        (-0.03139, -0.00355, -0.02652, 0.03818, -0.21134, -0.0275, 0.07138),
        (0.00455, 0.00032, 0.00223, 0.03844, 0.00277, 0.0005, 0.00795),
        (0.00454, 0.0001, 0.00219, 0.01144, 0.00284, 0.00281, 0.01089),
        (0.00029, 0.00042, 0.00073, 0.04988, 0.00012, 0.00232, 0.00294),
        (0, 0, -0.00005, 0.00088, -0.00001, -0.00005, 0.00022),
        (0.00001, 0, 0.00007, -0.00111, 0, -0.00004, -0.00029),
        (0, 0, 0.00007, -0.00112, 0.00001, -0.00003, -0.00029),
    ),
    (np.diag([-1.0, -1.0, 1.0]),) * 7,
    {7: (None, "the moments break the triangle inequality and would need a body three times as wide as the link")},
)

ARMS = {
    "LBR7R800": Arm(
        name="LBR7R800",
        lengths=_LENGTHS_7,
        seams=_SEAMS_7,
        speeds_deg=(98, 98, 100, 130, 140, 180, 180),
        torques=(176, 176, 110, 110, 110, 40, 40),
        mass=23.9,
        links=_LINKS_7,
        replaced=_REPLACED_7,
    ),
    "LBR14R820": Arm(
        name="LBR14R820",
        lengths=_LENGTHS_14,
        seams=_SEAMS_14,
        speeds_deg=(85, 85, 100, 75, 130, 135, 135),
        torques=(320, 320, 176, 176, 110, 40, 40),
        mass=29.9,
        links=_LINKS_14,
        replaced=_REPLACED_14,
    ),
}
