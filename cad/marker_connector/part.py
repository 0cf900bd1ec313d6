"""The ring between flange and connectors with the pad beside it that carries the tag, in the flange's frame."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, on_circle, rod


def solid() -> cq.Workplane:
    """Returns the part."""
    rim, half, pad = d.CONNECTOR_OUTER / 2, d.ARM_WIDTH / 2, d.PAD_WIDTH / 2
    back = d.PAD_FACE - d.PAD_THICKNESS
    body = rod(d.CONNECTOR_OUTER, 0.0, d.RING)
    body = body.union(block((-half, 0.0, 0.0), (half, d.PAD_FACE, d.RING)))
    body = body.union(block((-pad, back, 0.0), (pad, d.PAD_FACE, d.PAD_HEIGHT)).edges("|Y and >Z").fillet(6.0))
    profile = [(d.GUSSET_ROOT, d.RING), (back, d.RING), (back, d.GUSSET_TOP)]
    gusset = cq.Workplane("YZ").polyline(profile).close().extrude(d.GUSSET_WIDTH)
    body = body.union(gusset.translate((half - d.GUSSET_WIDTH, 0, 0))).union(gusset.translate((-half, 0, 0)))

    body = body.cut(rod(d.FLANGE_CENTRING + d.FIT, 0.0, d.RING))
    body = body.cut(rod(d.M6_HOLE, 0.0, d.RING, on_circle(d.FLANGE_CIRCLE, d.FLANGE_SCREWS)))
    body = body.cut(rod(d.DOWEL_PILOT, 0.0, d.RING, on_circle(d.FLANGE_CIRCLE, d.DOWELS)))
    for x, z in d.PAD_SCREWS:
        body = body.cut(cq.Workplane("XZ", origin=(x, back, z)).circle(d.M4_HOLE / 2).extrude(-d.PAD_THICKNESS))
    return body.cut(block((rim - d.MARK_DEPTH, -d.MARK_WIDTH / 2, 0.0), (rim, d.MARK_WIDTH / 2, d.RING)))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    front = sheet.view(part, "z", (82, 100), "from the hand", 6)
    front.circle((0, 0), d.FLANGE_CIRCLE)
    front.diameter((0, 0), d.CONNECTOR_OUTER, -50, f"Ø{d.CONNECTOR_OUTER:g}")
    front.leader(
        on_circle(d.FLANGE_CIRCLE, [225])[0],
        (-8, -40),
        [f"4 × Ø{d.M6_HOLE:g} and 4 × Ø{d.DOWEL_PILOT:g}", f"(to 6 H7) on Ø{d.FLANGE_CIRCLE:g}"],
    )
    front.leader((0, -d.FLANGE_CENTRING / 2), (26, -44), [f"Ø{d.FLANGE_CENTRING + d.FIT:g}"])
    front.vertical(-d.PAD_WIDTH / 2, 0.0, d.PAD_FACE, -6, from_u=-d.CONNECTOR_OUTER / 2)
    front.leader((d.CONNECTOR_OUTER / 2 - 1, 0), (14, -14), ["mark: flange's x"])

    pad = sheet.view(part, "y", (205, 80), "from the camera", 15)
    xs = sorted({x for x, _ in d.PAD_SCREWS})
    pad.horizontal(xs[0], xs[1], d.PAD_HEIGHT, 7, f"{xs[1] - xs[0]:g}", from_v=d.PAD_SCREWS[2][1])
    pad.vertical(d.PAD_WIDTH / 2, 0.0, d.PAD_SCREWS[0][1], 8, from_u=xs[1])
    pad.vertical(d.PAD_WIDTH / 2, 0.0, d.PAD_SCREWS[2][1], 15, from_u=xs[1])
    pad.vertical(d.PAD_WIDTH / 2, 0.0, d.PAD_HEIGHT, 22)
    pad.leader((xs[0], d.PAD_SCREWS[0][1]), (16, 8), [f"4 × Ø{d.M4_HOLE:g}"])
    pad.horizontal(-d.PAD_WIDTH / 2, d.PAD_WIDTH / 2, 0.0, -9)

    side = sheet.section(part, "x", (210, 172), "section", 14)
    side.vertical(-d.CONNECTOR_OUTER / 2, 0.0, d.RING, -8)
    side.horizontal(0.0, d.PAD_FACE, 0.0, -9)
    side.horizontal(d.PAD_FACE - d.PAD_THICKNESS, d.PAD_FACE, d.PAD_HEIGHT, 6)
