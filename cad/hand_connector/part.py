"""The connector on the hand's back shell: origin on the face that meets the first connector, the hand at the top."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, cone, nuts, on_circle, rod


def solid() -> cq.Workplane:
    """Returns the part."""
    top, rim = d.HAND_CONNECTOR, d.CONNECTOR_OUTER / 2
    body = rod(d.CONNECTOR_OUTER, 0.0, top).faces("<Z or >Z").chamfer(1.0)
    body = body.cut(rod(d.HAND_BORE, 0.0, top))

    bolts = on_circle(d.HAND_CIRCLE, d.HAND_BOLTS)
    body = body.cut(rod(d.M6_HOLE, 0.0, top, bolts))
    body = body.cut(nuts(d.M6_NUT_WIDTH, 0.0, d.HAND_NUT_POCKET, bolts))

    screws = on_circle(d.JOINT_CIRCLE, d.JOINT_SCREWS)
    body = body.cut(rod(d.M5_HOLE, 0.0, top, screws))
    for place in screws:
        body = body.cut(cone(d.M5_COUNTERSINK, top, place))

    for angle in d.CABLES:
        channel = block((0.0, -d.CABLE_WIDTH / 2, top - d.CABLE_DEPTH), (rim, d.CABLE_WIDTH / 2, top))
        body = body.cut(channel.rotate((0, 0, 0), (0, 0, 1), angle))
    return body


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    front = sheet.view(part, "z", (80, 78), "from the hand")
    front.diameter((0, 0), d.CONNECTOR_OUTER, -35, f"Ø{d.CONNECTOR_OUTER:g}")
    front.circle((0, 0), d.HAND_CIRCLE)
    front.circle((0, 0), d.JOINT_CIRCLE)
    front.leader(on_circle(d.HAND_CIRCLE, [120])[0], (-14, 26), [f"3 × Ø{d.M6_HOLE:g} on Ø{d.HAND_CIRCLE:g}"])
    front.leader(
        on_circle(d.JOINT_CIRCLE, [60])[0],
        (20, 24),
        [f"3 × Ø{d.M5_HOLE:g} on Ø{d.JOINT_CIRCLE:g},", f"countersunk 90° Ø{d.M5_COUNTERSINK:g}"],
    )
    front.leader(
        (0, -d.CONNECTOR_OUTER / 2 + 4), (-16, -12), [f"way of the cables, {d.CABLE_WIDTH:g} × {d.CABLE_DEPTH:g}"]
    )

    back = sheet.view(part, "-z", (215, 78), "from the arm", 14)
    back.leader(
        back.seen(on_circle(d.HAND_CIRCLE, [120])[0]),
        (2, 26),
        [f"3 nuts M6, {d.M6_NUT_WIDTH + d.NUT_PLAY:g} wide, {d.HAND_NUT_POCKET:g} deep"],
    )
    back.horizontal(-d.HAND_BORE / 2, d.HAND_BORE / 2, 0, -52, f"Ø{d.HAND_BORE:g}")

    rim = d.CONNECTOR_OUTER / 2
    section = sheet.section(part, "y", (80, 160), "section through a bolt")
    section.vertical(rim, 0.0, d.HAND_CONNECTOR, 10)
    side = sheet.section(part, "x", (215, 160), "section through the cables' way")
    side.vertical(-rim, 0.0, d.HAND_CONNECTOR - d.CABLE_DEPTH, -10)
    side.vertical(rim, d.HAND_CONNECTOR - d.CABLE_DEPTH, d.HAND_CONNECTOR, 10)
