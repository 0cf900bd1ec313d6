"""The bracket of the large panel, in the panel's frame: the plate lies on z = 0, y is the flange's z."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, rod

HOLES = [(-x, z - d.PANEL_BEYOND) for x, z in d.PAD_SCREWS]


def solid() -> cq.Workplane:
    """Returns the part."""
    end, beam, pad, deep = d.BRACKET_END, d.BRACKET_BEAM / 2, d.PAD_WIDTH / 2, -d.BRACKET_THICKNESS
    body = block((-end, -beam, deep), (end, beam, 0.0))
    body = body.union(block((-beam, -d.PANEL_BEYOND, deep), (beam, end, 0.0)))
    body = body.union(block((-pad, -d.PANEL_BEYOND, deep), (pad, d.PAD_HEIGHT - d.PANEL_BEYOND, 0.0)))
    body = body.edges("|Z").fillet(6.0)
    body = body.cut(rod(d.M4_INSERT_HOLE, deep, deep + d.M4_INSERT_DEPTH, HOLES))
    return body.cut(rod(d.M4_INSERT_HOLE, -d.M4_INSERT_DEPTH, 0.0, d.PANEL_SCREWS))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    end = d.BRACKET_END
    front = sheet.view(part, "z", (80, 90), "from the camera")
    screw = d.PANEL_SCREWS[1][0]
    front.horizontal(-screw, screw, end, 8, f"{2 * screw:g}", from_v=0.0)
    front.horizontal(-end, end, end, 16)
    front.vertical(end, -screw, screw, 10, from_u=0.0)
    front.vertical(-end, -d.PANEL_BEYOND, end, -8)
    front.leader((-screw, 0), (6, 26), [f"4 × Ø{d.M4_INSERT_HOLE:g}, {d.M4_INSERT_DEPTH:g} deep", "inserts M4, plate"])
    front.cross((0, 0))
    back = sheet.view(part, "-z", (215, 90), "from the arm", 14)
    us = sorted({u for u, _ in HOLES})
    vs = sorted({v for _, v in HOLES})
    back.horizontal(us[0], us[1], -d.PANEL_BEYOND, -8, f"{us[1] - us[0]:g}", from_v=vs[0])
    back.vertical(end, vs[0], 0.0, 6, from_u=us[1])
    back.vertical(-end, vs[1], 0.0, -8, from_u=us[0])
    back.leader(
        (us[1], vs[0]), (16, -16), [f"4 × Ø{d.M4_INSERT_HOLE:g}, {d.M4_INSERT_DEPTH:g} deep", "inserts M4, pad"]
    )
    edge = sheet.view(part, "y", (80, 168), "edge")
    edge.vertical(end, -d.BRACKET_THICKNESS, 0.0, 8)
