"""What the arm's links look like: smooth housings as solids, rings and covers as cylinders. Own shapes, no CAD data.

Millimetres, in the axes of the upright pose, origin in the link's own origin. Each of links 1 to 4 is an elbow: a tube
that starts at a seam across the arm and ends in one half of a joint's housing beside the arm's axis; the other half
belongs to the next link.
"""

from __future__ import annotations

from rig_description.appearance import DARK, GREY, ORANGE, PAD, WHITE, Disc
from rig_description.arms import ArmDescription
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

TUBE = 68.0
HOUSING = 86.0
HOUSING_SIDE = 92.0
GAP = 1.0
RING = 9.0
COLLAR = 20.0
LINK_6_SIDE = 46.0

CELL = 11.5


def _elbow(length: float) -> Solid:
    """A tube that comes from `length` below the joint's axis up into the half of its housing at negative y."""
    tube = rod((0, 0, -length - 60), (0, -4, -78), TUBE, TUBE)
    neck = rod((0, -12, -70), (0, -36, 0), TUBE, 44)
    side = drum(1, -HOUSING_SIDE, -GAP, HOUSING, edge=30.0)
    body = blend(30.0, tube, neck, side)
    body = common_part(4.0, body, above(2, -length + RING / 2))
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
    body = blend(36.0, tube, neck, side)
    body = common_part(4.0, body, above(2, -length + RING / 2))
    return cut(8.0, body, drum(1, -LINK_6_SIDE - GAP, 200.0, 74.0, edge=1.0))


def _wrist() -> Solid:
    """Link 6: a drum across the arm with the round exit of axis 7."""
    head = drum(1, -LINK_6_SIDE + GAP, 66.0, 70.0, edge=26.0)
    exit_ = rod((0, 8, 0), (0, 0, 70), 62, 50)
    return common_part(4.0, blend(20.0, head, exit_), below(2, 78.0))


def _turned_over(solid: Solid) -> Solid:
    """The solid turned by 180 deg about x."""
    return mirrored(1, mirrored(2, solid))


def housing(arm: ArmDescription, link: int) -> Mesh:
    """Returns the surface of link 0 to 6 [mm]."""
    low, middle, high = (1e3 * seam for seam in arm.seams)
    shoulder, upper, fore = (1e3 * length for length in arm.lengths)
    solid, span = {
        0: (_base(low), ((-170, -135, -15), (135, 135, low + 15))),
        1: (_elbow(shoulder - low), ((-110, -110, low - shoulder - 9), (110, 110, 110))),
        2: (_turned_over(_elbow(middle)), ((-110, -110, -110), (110, 110, middle + 15))),
        3: (mirrored(1, _elbow(upper - middle)), ((-110, -110, middle - upper - 9), (110, 110, 110))),
        4: (mirrored(2, _elbow(high)), ((-110, -110, -110), (110, 110, high + 15))),
        5: (_forearm(fore - high), ((-110, -115, high - fore - 9), (110, 110, 90))),
        6: (_wrist(), ((-95, -95, -95), (95, 95, 105))),
    }[link]
    return surface(solid, *span, CELL)


def trim(arm: ArmDescription, link: int) -> list[Disc]:
    """Returns the rings at the link's seams and the covers of its joint housing."""
    low, middle, high = (1e3 * seam for seam in arm.seams)
    shoulder, upper, fore = (1e3 * length for length in arm.lengths)
    up, down = {
        0: (low, None),
        1: (None, low - shoulder),
        2: (middle, None),
        3: (None, middle - upper),
        4: (high, None),
        5: (None, high - fore),
        6: (78.0, None),
        7: (None, 78.0),
    }[link]
    discs = []
    if link == 0:
        discs.append(_across(WHITE, 107.0, 0.0, 14.0))
    if up is not None and link != 6:
        discs.append(_across(WHITE, TUBE + 0.6, up - COLLAR, up - GAP))
        discs.append(_across(GREY, TUBE + 1.0, up - RING, up - GAP))
    if down is not None and link != 7:
        discs.append(_across(WHITE, TUBE + 0.6, down, down + COLLAR))
        discs.append(_across(ORANGE, TUBE + 1.0, down, down + RING))
    if link in (1, 4):
        discs += [_aside(ORANGE, 54.0, -HOUSING_SIDE - 1.5, -80.0), _aside(GREY, 46.0, -HOUSING_SIDE - 2.5, -80.0)]
    if link in (2, 3):
        discs += [_aside(ORANGE, 54.0, 80.0, HOUSING_SIDE + 1.5), _aside(GREY, 46.0, 80.0, HOUSING_SIDE + 2.5)]
    if link == 6:
        discs += [_aside(ORANGE, 40.0, 56.0, 66.5), _aside(GREY, 36.0, 56.0, 68.0)]
    if link == 7:
        discs += [_across(DARK, 46.0, 76.0, 84.0), _across(GREY, 48.0, 84.0, 126.0)]
    return discs


def media_flange(name: str, height: float) -> list[Disc]:
    """Returns the look of a media flange whose outer face is the origin."""
    discs = [_across(GREY, 50.0, -height, -height + 12.0), _across(DARK, 49.0, -height + 12.0, -6.0)]
    if name == "MF_touch_pneumatisch":
        discs.append(_across(PAD, 50.0, -24.0, -18.0))
    return [*discs, _across(GREY, 50.0, -6.0, 0.0)]


def _across(colour: tuple[float, float, float], radius: float, bottom: float, top: float) -> Disc:
    return Disc(colour, radius, (0.0, 0.0, bottom), (0.0, 0.0, top))


def _aside(colour: tuple[float, float, float], radius: float, near: float, far: float) -> Disc:
    return Disc(colour, radius, (0.0, near, 0.0), (0.0, far, 0.0))
