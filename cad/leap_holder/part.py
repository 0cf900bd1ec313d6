"""The table holder of the Leap Motion controller: the table is z = 0, the person sits at -y, the cable leaves at -x."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, nuts, rod

POCKET = (d.LEAP[0] + d.LEAP_PLAY, d.LEAP[1] + d.LEAP_PLAY)


def solid() -> cq.Workplane:
    """Returns the part."""
    length, width, thick = d.LEAP_BASE
    top, wall = thick + d.LEAP_POCKET, d.LEAP_WALL
    body = block((-length / 2, -width / 2, 0.0), (length / 2, width / 2, thick)).edges("|Z").fillet(8.0)
    outer = (POCKET[0] / 2 + wall, POCKET[1] / 2 + wall)
    body = body.union(block((-outer[0], -outer[1], 0.0), (*outer, top)).edges("|Z").fillet(4.0))
    body = body.cut(block((-POCKET[0] / 2, -POCKET[1] / 2, thick), (POCKET[0] / 2, POCKET[1] / 2, top)))
    body = body.cut(block((-outer[0], -d.LEAP_CABLE / 2, thick), (0.0, d.LEAP_CABLE / 2, top)))
    # A hole in the floor through which a finger lifts the controller out.
    body = body.cut(rod(16.0, 0.0, thick))

    body = body.cut(rod(d.M5_HOLE, d.JOINT_NUT_POCKET + d.MEMBRANE, thick, d.LEAP_FEET))
    body = body.cut(nuts(d.M5_NUT_WIDTH, 0.0, d.JOINT_NUT_POCKET, d.LEAP_FEET))
    body = body.cut(rod(d.LEVEL_DIAMETER, thick - d.LEVEL_DEPTH, thick, [d.LEVEL_PLACE]))
    tip = cq.Workplane(origin=(24, -37, thick - 1)).polyline([(0, -3), (8, -3), (4, 3)]).close().extrude(1)
    return body.cut(tip.rotate((28, -37, 0), (28, -37, 1), 180))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    length, width, thick = d.LEAP_BASE
    top = sheet.view(part, "z", (105, 78), "from above")
    top.horizontal(-length / 2, length / 2, -width / 2, -18)
    top.horizontal(-POCKET[0] / 2, POCKET[0] / 2, width / 2, 8, f"{POCKET[0]:g}", from_v=POCKET[1] / 2)
    top.horizontal(d.LEAP_FEET[0][0], d.LEAP_FEET[2][0], width / 2, 16, from_v=d.LEAP_FEET[1][1])
    top.vertical(length / 2, -width / 2, width / 2, 16)
    top.vertical(length / 2, -POCKET[1] / 2, POCKET[1] / 2, 8, f"{POCKET[1]:g}", from_u=POCKET[0] / 2)
    top.vertical(-length / 2, d.LEAP_FEET[0][1], d.LEAP_FEET[1][1], -8, from_u=d.LEAP_FEET[0][0])
    top.leader(
        (d.LEVEL_PLACE[0] - 5, d.LEVEL_PLACE[1] - 4),
        (-26, -18),
        [f"Ø{d.LEVEL_DIAMETER:g}, {d.LEVEL_DEPTH:g} deep, bubble level"],
    )
    top.leader((28, -37), (18, -17), ["to the person"])
    top.leader(d.LEAP_FEET[2], (26, -26), [f"3 × Ø{d.M5_HOLE:g},", "nuts M5 below"])
    section = sheet.section(part, "y", (105, 168), "section")
    section.vertical(length / 2, 0.0, thick, 8)
    section.vertical(length / 2, thick, thick + d.LEAP_POCKET, 8, from_u=POCKET[0] / 2 + d.LEAP_WALL)
    side = sheet.view(part, "-x", (243, 78), "from the cable")
    side.horizontal(-d.LEAP_CABLE / 2, d.LEAP_CABLE / 2, thick + d.LEAP_POCKET, 8)
