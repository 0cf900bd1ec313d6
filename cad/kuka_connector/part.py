"""The connector on the arm's flange, in the flange's frame: the hand's side is at the top."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import block, nuts, on_circle, rod


def solid() -> cq.Workplane:
    """Returns the part."""
    top = d.KUKA_CONNECTOR
    body = rod(d.CONNECTOR_OUTER, 0.0, top).faces("<Z or >Z").chamfer(1.0)
    body = body.union(rod(d.FLANGE_CENTRING - d.FIT, -d.SPIGOT, 0.0).faces("<Z").chamfer(0.6))
    body = body.cut(rod(d.BORE, -d.SPIGOT, top))

    screws = on_circle(d.FLANGE_CIRCLE, d.FLANGE_SCREWS)
    body = body.cut(rod(d.M6_HOLE, 0.0, d.SCREW_FLOOR - d.MEMBRANE, screws))
    body = body.cut(rod(d.SCREW_POCKET, d.SCREW_FLOOR, top, screws))
    body = body.cut(rod(d.DOWEL_PILOT, 0.0, d.DOWEL_DEPTH, on_circle(d.FLANGE_CIRCLE, d.DOWELS)))

    steps = [d.JOINT_STEP * i for i in range(round(360.0 / d.JOINT_STEP))]
    joints = on_circle(d.JOINT_CIRCLE, steps)
    body = body.cut(rod(d.M5_HOLE, 0.0, top, joints))
    body = body.cut(nuts(d.M5_NUT_WIDTH, 0.0, d.JOINT_NUT_POCKET, joints))

    rim, half = d.CONNECTOR_OUTER / 2, d.MARK_WIDTH / 2
    return body.cut(block((rim - d.MARK_DEPTH, -half, 0.0), (rim, half, top)))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    count = round(360.0 / d.JOINT_STEP)
    front = sheet.view(part, "z", (80, 78), "from the hand")
    front.diameter((0, 0), d.CONNECTOR_OUTER, -35, f"Ø{d.CONNECTOR_OUTER:g}")
    front.circle((0, 0), d.FLANGE_CIRCLE)
    front.circle((0, 0), d.JOINT_CIRCLE)
    front.leader(
        on_circle(d.FLANGE_CIRCLE, [135])[0],
        (-12, 36),
        [f"4 × Ø{d.M6_HOLE:g}, pocket Ø{d.SCREW_POCKET:g}", f"on Ø{d.FLANGE_CIRCLE:g}, at 45°"],
    )
    front.leader(
        on_circle(d.JOINT_CIRCLE, [60])[0],
        (12, 26),
        [f"{count} × Ø{d.M5_HOLE:g} on Ø{d.JOINT_CIRCLE:g}, every {d.JOINT_STEP:g}°"],
    )
    front.leader((d.CONNECTOR_OUTER / 2 - 1, 0), (12, 8), ["mark: flange's x"])

    back = sheet.view(part, "-z", (215, 78), "from the flange")
    back.leader(
        back.seen(on_circle(d.JOINT_CIRCLE, [60])[0]),
        (-2, 19),
        [f"{count} nuts M5, {d.M5_NUT_WIDTH + d.NUT_PLAY:g} wide, {d.JOINT_NUT_POCKET:g} deep"],
    )
    back.leader(
        back.seen(on_circle(d.FLANGE_CIRCLE, [270])[0]),
        (42, -24),
        [f"4 × Ø{d.DOWEL_PILOT:g}, {d.DOWEL_DEPTH:g} deep,", "reamed to 6 H7"],
    )
    back.leader((0, d.FLANGE_CENTRING / 2), (26, 34), [f"spigot Ø{d.FLANGE_CENTRING - d.FIT:g} into 31.5 H7"])

    section = sheet.section(part, "y", (80, 160), "section through the axis")
    rim = d.CONNECTOR_OUTER / 2
    section.vertical(rim, 0.0, d.KUKA_CONNECTOR, 10)
    section.vertical(-rim, -d.SPIGOT, 0.0, -10, from_u=-d.FLANGE_CENTRING / 2)
    section.horizontal(-d.BORE / 2, d.BORE / 2, d.KUKA_CONNECTOR, 9, f"Ø{d.BORE:g}")
    cut = sheet.section(part, "diagonal", (215, 160), "section at 45°")
    cut.vertical(-rim, 0.0, d.SCREW_FLOOR, -10)
    cut.horizontal(
        d.FLANGE_CIRCLE / 2 - d.SCREW_POCKET / 2,
        d.FLANGE_CIRCLE / 2 + d.SCREW_POCKET / 2,
        d.KUKA_CONNECTOR,
        9,
        f"Ø{d.SCREW_POCKET:g}",
    )
