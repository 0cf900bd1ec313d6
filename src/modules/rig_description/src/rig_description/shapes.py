"""What the links of arm and hand look like: smooth solids, rings and covers as cylinders, own shapes without CAD data.

Millimetres. The arm's are in the axes of the upright pose, origin in the link's own origin. Each of links 1 to 4 is an
elbow: a tube that starts at a seam across the arm and ends in one half of a joint's housing beside the arm's axis; the
other half belongs to the next link. The hand's, dark links and blue rubber pads with the vendor's dimensions, are in
the link's own frame.
"""

from __future__ import annotations

from dataclasses import dataclass

from rig_description.arms import ArmDescription
from rig_description.hand import CONNECTOR_FACES, CONNECTOR_RADIUS
from rig_description.solids import (
    Mesh,
    Solid,
    above,
    below,
    blend,
    block,
    common_part,
    cut,
    drum,
    mirrored,
    rod,
    surface,
)

COLOURS = {
    "white": (0.86, 0.87, 0.88),
    "grey": (0.45, 0.47, 0.49),
    "dark": (0.13, 0.13, 0.14),
    "orange": (1.0, 0.36, 0.0),
    "table": (0.82, 0.84, 0.87),
    "shell": (0.1, 0.1, 0.1),
    "link": (0.16, 0.16, 0.16),
    "flexure": (0.2, 0.2, 0.2),
    "pad": (0.106, 0.227, 0.631),
}
"""Red, green, blue from 0 to 1."""


@dataclass(frozen=True)
class Disc:
    """A cylinder of one colour."""

    colour: str  # its name
    radius: float  # [mm]
    bottom: tuple[float, float, float]  # centre of its lower face [mm]
    top: tuple[float, float, float]  # centre of its upper face [mm]


TUBE, HOUSING, HOUSING_SIDE, LINK_6_SIDE = 68.0, 86.0, 92.0, 46.0
GAP, RING, COLLAR = 1.0, 9.0, 20.0
CELL = 11.5


def _elbow(length: float) -> Solid:
    """A tube that comes from `length` below the joint's axis up into the half of its housing at negative y."""
    tube = rod((0, 0, -length - 60), (0, -4, -78), TUBE, TUBE)
    neck = rod((0, -12, -70), (0, -36, 0), TUBE, 44)
    side = drum(1, -HOUSING_SIDE, -GAP, HOUSING, edge=30.0)
    body = common_part(4.0, blend(30.0, tube, neck, side), above(2, -length + RING / 2))
    return cut(8.0, body, drum(1, -GAP, 200.0, HOUSING + 4.0, edge=1.0))


def _base(height: float) -> Solid:
    foot = drum(2, 0.0, 34.0, 104.0, edge=6.0)
    plugs = block((-142.0, -62.0, 0.0), (-20.0, 62.0, 92.0), edge=12.0)
    column = rod((0, 0, -40), (0, 0, height + 60), 102.0, TUBE - 11)
    return common_part(4.0, blend(24.0, column, plugs, foot), above(2, 0.0), below(2, height - RING / 2))


def _forearm(length: float) -> Solid:
    """Link 5: from the seam up to a plate beside the wrist at negative y."""
    tube = rod((0, 0, -length - 60), (0, -6, -96), TUBE, TUBE - 2)
    neck = rod((0, -18, -92), (0, -66, 0), 58, 44)
    side = drum(1, -98.0, -LINK_6_SIDE - GAP, 62.0, edge=18.0)
    body = common_part(4.0, blend(36.0, tube, neck, side), above(2, -length + RING / 2))
    return cut(8.0, body, drum(1, -LINK_6_SIDE - GAP, 200.0, 74.0, edge=1.0))


def _wrist() -> Solid:
    """Link 6: a drum across the arm with the round exit of axis 7."""
    head = drum(1, -LINK_6_SIDE + GAP, 66.0, 70.0, edge=26.0)
    exit_ = rod((0, 8, 0), (0, 0, 70), 62, 50)
    return common_part(4.0, blend(20.0, head, exit_), below(2, 78.0))


def housing(arm: ArmDescription, link: int) -> Mesh:
    """Returns the surface of link 0 to 6 [mm]."""
    low, middle, high = (1e3 * seam for seam in arm.seams)
    shoulder, upper, fore = (1e3 * length for length in arm.lengths)
    solid, span = {
        0: (_base(low), ((-170, -135, -15), (135, 135, low + 15))),
        1: (_elbow(shoulder - low), ((-110, -110, low - shoulder - 9), (110, 110, 110))),
        2: (mirrored(1, mirrored(2, _elbow(middle))), ((-110, -110, -110), (110, 110, middle + 15))),
        3: (mirrored(1, _elbow(upper - middle)), ((-110, -110, middle - upper - 9), (110, 110, 110))),
        4: (mirrored(2, _elbow(high)), ((-110, -110, -110), (110, 110, high + 15))),
        5: (_forearm(fore - high), ((-110, -115, high - fore - 9), (110, 110, 90))),
        6: (_wrist(), ((-95, -95, -95), (95, 95, 105))),
    }[link]
    return surface(solid, *span, CELL)


def arm_trim(arm: ArmDescription, link: int) -> list[Disc]:
    """Returns the rings at the link's seams and the covers of its joint housing."""
    low, middle, high = (1e3 * seam for seam in arm.seams)
    shoulder, upper, fore = (1e3 * length for length in arm.lengths)
    up = {0: low, 2: middle, 4: high}.get(link)
    down = {1: low - shoulder, 3: middle - upper, 5: high - fore}.get(link)
    discs = [_across("white", 107.0, 0.0, 14.0)] if link == 0 else []
    if up is not None:
        discs += [_across("white", TUBE + 0.6, up - COLLAR, up - GAP), _across("grey", TUBE + 1.0, up - RING, up - GAP)]
    if down is not None:
        discs += [_across("white", TUBE + 0.6, down, down + COLLAR), _across("orange", TUBE + 1.0, down, down + RING)]
    if link in (1, 4):
        discs += [_aside("orange", 54.0, -HOUSING_SIDE - 1.5, -80.0), _aside("grey", 46.0, -HOUSING_SIDE - 2.5, -80.0)]
    if link in (2, 3):
        discs += [_aside("orange", 54.0, 80.0, HOUSING_SIDE + 1.5), _aside("grey", 46.0, 80.0, HOUSING_SIDE + 2.5)]
    if link == 6:
        discs += [_aside("orange", 40.0, 56.0, 66.5), _aside("grey", 36.0, 56.0, 68.0)]
    if link == 7:
        discs += [_across("dark", 46.0, 76.0, 84.0), _across("grey", 48.0, 84.0, 126.0)]
    return discs


def media_flange(name: str, height: float) -> list[Disc]:
    """Returns the look of a media flange whose outer face is the origin."""
    discs = [_across("grey", 50.0, -height, -height + 12.0), _across("dark", 49.0, -height + 12.0, -6.0)]
    if name == "MF_touch_pneumatisch":
        discs.append(_across("pad", 50.0, -24.0, -18.0))
    return [*discs, _across("grey", 50.0, -6.0, 0.0)]


def _across(colour: str, radius: float, bottom: float, top: float) -> Disc:
    return Disc(colour, radius, (0.0, 0.0, bottom), (0.0, 0.0, top))


def _aside(colour: str, radius: float, near: float, far: float) -> Disc:
    return Disc(colour, radius, (0.0, near, 0.0), (0.0, far, 0.0))


SWIVEL_CENTRES = ((50.4, -26.0), (50.4, 26.0))


def _shell() -> Mesh:
    foot = drum(2, -20.0, 40.0, 41.0, edge=6.0)
    rim = block((-55.0, -53.0, 34.0), (83.0, 53.0, 76.0), edge=20.0)
    thumb = block((-55.0, -24.0, 50.0), (-12.0, 24.0, 92.0), edge=7.0)
    seats = [drum(2, 62.0, 120.0, 23.0, centre, edge=1.0) for centre in SWIVEL_CENTRES]
    body = common_part(3.0, blend(30.0, foot, rim, thumb), above(2, 0.0), below(2, 92.0))
    slot = block((-90.0, -10.5, 66.0), (-18.0, 10.5, 120.0), edge=2.0)
    return surface(cut(3.0, body, slot, *seats), (-70, -70, -12), (98, 70, 106), 6.5)


def _palm() -> Mesh:
    pad = block((-16.0, -50.0, 66.0), (80.0, 50.0, 89.0), edge=9.0)
    seats = [drum(2, 40.0, 120.0, 23.5, centre, edge=1.0) for centre in SWIVEL_CENTRES]
    return surface(cut(3.0, pad, *seats), (-26, -60, 56), (92, 60, 100), 4.5)


def _swivel() -> Mesh:
    table = drum(2, 0.0, 10.0, 20.0, edge=2.0)
    cheeks = common_part(3.0, rod((8, -18, 16), (8, 18, 16), 13, 13), block((-20, -17.5, 2), (22, 17.5, 29), 3.0))
    body = blend(4.0, table, cheeks)
    return surface(cut(4.0, body, block((-40, -9, 8), (40, 9, 60), 3.0)), (-28, -26, -8), (30, 26, 38), 3.2)


def _proximal() -> Mesh:
    beam = blend(6.0, rod((0, 0, 0), (56, 0, -1), 9, 6.5), block((0, -7, -8), (60, 7, 5), 2.5))
    beam = common_part(3.0, beam, block((-12, -7.5, -9), (61, 7.5, 8), 2.0))
    return surface(beam, (-18, -14, -16), (68, 14, 15), 3.2)


def _distal_pad() -> Mesh:
    pad = blend(5.0, block((9, -8, -6), (40, 8, 10), 4.0), rod((34, 0, 1), (40, 0, 0), 8.5, 7.5))
    return surface(pad, (3, -15, -13), (54, 15, 17), 3.0)


MESHES = {
    "shell": (_shell, "shell"),
    "palm": (_palm, "pad"),
    "swivel": (_swivel, "shell"),
    "proximal": (_proximal, "link"),
    "proximal_pad": (lambda: surface(block((12, -8, -7), (61, 8, 14), 4.0), (6, -14, -14), (68, 14, 20), 3.2), "pad"),
    "flexure": (lambda: surface(block((-9, -7, -6), (13, 7, -1), 2.0), (-15, -13, -12), (19, 13, 5), 2.6), "flexure"),
    "distal": (lambda: surface(rod((12, 0, -3), (34, 0, -3), 6.5, 5), (0, -13, -16), (46, 13, 10), 2.6), "link"),
    "distal_pad": (_distal_pad, "pad"),
}
"""Function that makes the surface, and colour, by the mesh's name."""
LOOK = {
    "base_link": ("shell", "palm"),
    "swivel": ("swivel",),
    "proximal": ("proximal", "proximal_pad"),
    "distal": ("flexure", "distal", "distal_pad"),
}
"""Meshes of each part of the hand."""


def hand_trim(part: str) -> list[Disc]:
    """Returns the cylinders on a part: connector, knuckles."""
    if part == "base_link":
        bottom, top = (tuple(1e3 * face) for face in CONNECTOR_FACES)
        return [Disc("grey", 1e3 * CONNECTOR_RADIUS, bottom, top)]
    if part == "proximal":
        return [Disc("flexure", 5.0, (0.0, -9.5, 0.0), (0.0, 9.5, 0.0))]
    return []
