"""The plate of the single tag, in the tag's frame without the sheet: the tag sticks on z = 0, y is the flange's z."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, rod

DEPTH = d.TAG_DISTANCE - d.SHEET - d.PAD_FACE
HOLES = [(-x, z - d.SINGLE_BEYOND) for x, z in d.PAD_SCREWS]


def solid() -> cq.Workplane:
    """Returns the part."""
    half, pad, rib = d.SINGLE_PLATE / 2, d.PAD_WIDTH / 2, d.SINGLE_RIB / 2
    low, high = -d.SINGLE_BEYOND, d.PAD_HEIGHT - d.SINGLE_BEYOND
    body = block((-half, -half, -d.SINGLE_SKIN), (half, half, 0.0)).edges("|Z").fillet(4.0)
    body = body.union(block((-pad, low, -DEPTH), (pad, high, 0.0)))
    for u in (-pad + rib, 0.0, pad - rib):
        body = body.union(block((u - rib, -half + 4, -DEPTH), (u + rib, half - 4, 0.0)))
    # Hollow between the screws, but for the rib in the middle.
    inner = min(u for u, _ in HOLES if u > 0.0) - 2 * d.SINGLE_RIB
    for left in (-inner, rib):
        hollow = (left, low + 2 * rib, -DEPTH), (left + inner - rib, high - 2 * rib, -d.SINGLE_SKIN)
        body = body.cut(block(*hollow))
    return body.cut(rod(d.M4_INSERT_HOLE, -DEPTH, -DEPTH + d.M4_INSERT_DEPTH, HOLES))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    half = d.SINGLE_PLATE / 2
    back = sheet.view(part, "-z", (95, 98), "from the arm")
    us = sorted({u for u, _ in HOLES})
    vs = sorted({v for _, v in HOLES})
    back.horizontal(us[0], us[1], half, 7, f"{us[1] - us[0]:g}", from_v=vs[1])
    back.horizontal(-half, half, half, 16)
    back.vertical(half, -half, half, 16)
    back.vertical(half, 0.0, vs[1], 8, from_u=us[1])
    back.vertical(-half, vs[0], 0.0, -8, from_u=us[0])
    back.leader((us[0], vs[0]), (10, -46), [f"4 × Ø{d.M4_INSERT_HOLE:g}, {d.M4_INSERT_DEPTH:g} deep, inserts M4"])
    back.cross((0, 0))
    side = sheet.view(part, "edge", (210, 98), "side", 16)
    side.horizontal(-DEPTH, 0.0, half, 8)
    side.horizontal(-d.SINGLE_SKIN, 0.0, -half, -8)
    side.leader((0.0, 20), (16, 12), ["flat: the tag's sheet"])
