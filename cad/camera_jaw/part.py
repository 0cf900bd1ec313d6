"""The jaw over the camera: its plate lies on the camera at z = 0, the camera's back is at y = 0."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block


def solid() -> cq.Workplane:
    """Returns the part."""
    half, back = d.CRADLE_WIDTH / 2, d.CRADLE_BACK + d.JAW_THICKNESS
    body = block((-half, -d.JAW_REACH, 0.0), (half, back, d.JAW_THICKNESS)).edges("|Z").fillet(4.0)
    body = body.union(block((-half + 5, d.CRADLE_BACK, -d.JAW_FLANGE), (half - 5, back, d.JAW_THICKNESS)))
    for x in (-d.JAW_SCREWS, d.JAW_SCREWS):
        hole = cq.Workplane("XZ", origin=(x, d.CRADLE_BACK, -d.JAW_SCREW_BELOW)).circle(d.M4_HOLE / 2)
        body = body.cut(hole.extrude(-d.JAW_THICKNESS))
    return body


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    half = d.CRADLE_WIDTH / 2
    back = sheet.view(part, "y", (75, 70), "from behind", 15)
    back.horizontal(-half, half, d.JAW_THICKNESS, 8)
    back.horizontal(-d.JAW_SCREWS, d.JAW_SCREWS, -d.JAW_FLANGE, -8, from_v=-d.JAW_SCREW_BELOW)
    back.vertical(half, -d.JAW_SCREW_BELOW, 0.0, 8, from_u=d.JAW_SCREWS)
    back.leader((-d.JAW_SCREWS, -d.JAW_SCREW_BELOW), (-16, -18), [f"2 × Ø{d.M4_HOLE:g}"])
    side = sheet.section(part, "x", (200, 70), "section", 15)
    side.horizontal(-d.JAW_REACH, 0.0, d.JAW_THICKNESS, 8)
    side.vertical(d.CRADLE_BACK + d.JAW_THICKNESS, -d.JAW_FLANGE, d.JAW_THICKNESS, 8)
    side.horizontal(d.CRADLE_BACK, d.CRADLE_BACK + d.JAW_THICKNESS, -d.JAW_FLANGE, -8)
    sheet.view(part, "z", (75, 150), "from above")
