"""The camera's cradle: the camera stands on z = 0 and looks along -y, the tripod's screw comes from below."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, rod

BACK = d.XTION[1] / 2 + d.CRADLE_PLAY
SLOT = (d.XTION_LOWEST - d.JAW_SCREW_BELOW, d.XTION_HIGHEST - d.JAW_SCREW_BELOW)


def solid() -> cq.Workplane:
    """Returns the part."""
    half, low = d.CRADLE_WIDTH / 2, -d.CRADLE_FLOOR
    front, back = -BACK - d.CRADLE_LIP, BACK + d.CRADLE_BACK
    body = block((-half, front, low), (half, back, 0.0)).edges("|Z").fillet(4.0)
    body = body.union(block((-half + 5, front, -1.0), (half - 5, -BACK, d.CRADLE_LIP_HEIGHT)))
    body = body.union(block((-half + 5, BACK, -1.0), (half - 5, back, d.CRADLE_BACK_HEIGHT)))
    body = body.cut(block((-d.FOOT_GAP / 2, front, -d.FOOT_DEPTH), (d.FOOT_GAP / 2, BACK, d.CRADLE_LIP_HEIGHT)))
    body = body.cut(rod(d.QUARTER_INSERT_HOLE, low, low + d.QUARTER_INSERT_DEPTH))
    for x in (-d.JAW_SCREWS, d.JAW_SCREWS):
        slot = cq.Workplane("XZ", origin=(x, BACK, sum(SLOT) / 2))
        body = body.cut(slot.slot2D(SLOT[1] - SLOT[0] + d.M4_HOLE, d.M4_HOLE, 90).extrude(-d.CRADLE_BACK))
    return body


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    half = d.CRADLE_WIDTH / 2
    front = sheet.view(part, "-y", (80, 55), "from the front", 23)
    front.horizontal(-half, half, -d.CRADLE_FLOOR, -9)
    front.horizontal(-d.JAW_SCREWS, d.JAW_SCREWS, d.CRADLE_BACK_HEIGHT, 8, from_v=SLOT[1])
    front.vertical(half, 0.0, d.CRADLE_BACK_HEIGHT, 10, from_u=half - 5)
    front.vertical(half, -d.CRADLE_FLOOR, 0.0, 10)
    front.horizontal(-d.FOOT_GAP / 2, d.FOOT_GAP / 2, -d.CRADLE_FLOOR, -17, from_v=-d.FOOT_DEPTH)
    side = sheet.section(part, "x", (210, 55), "section")
    side.horizontal(-BACK, BACK, d.CRADLE_LIP_HEIGHT, 8)
    side.leader(
        (0, -d.CRADLE_FLOOR + 3),
        (14, -14),
        [f"Ø{d.QUARTER_INSERT_HOLE:g}, {d.QUARTER_INSERT_DEPTH:g} deep, insert 1/4″-20"],
    )
    top = sheet.view(part, "z", (80, 145), "from above")
    top.vertical(half, -BACK - d.CRADLE_LIP, BACK + d.CRADLE_BACK, 10)
    back = sheet.view(part, "y", (215, 140), "from behind")
    back.leader((d.JAW_SCREWS, SLOT[1]), (-8, 24), [f"2 slots Ø{d.M4_HOLE:g}, {SLOT[1] - SLOT[0]:g} long"])
    back.vertical(-half, 0.0, SLOT[0], -8, from_u=-d.JAW_SCREWS)
