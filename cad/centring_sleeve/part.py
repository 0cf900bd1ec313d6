"""The sleeve that centres the ring on the flange: half in the flange's recess, half in the ring's bore."""

from __future__ import annotations

import cadquery as cq

from cad import dimensions as d
from cad.drawing import Sheet
from cad.shapes import rod


def solid() -> cq.Workplane:
    """Returns the part."""
    body = rod(d.FLANGE_CENTRING - d.FIT, 0.0, d.SLEEVE_LENGTH).faces("<Z or >Z").chamfer(0.6)
    return body.cut(rod(d.BORE, 0.0, d.SLEEVE_LENGTH))


def draw(part: cq.Workplane, sheet: Sheet) -> None:
    """Draws the part."""
    front = sheet.view(part, "z", (80, 90), "along the axis", 17)
    front.horizontal(-d.BORE / 2, d.BORE / 2, 0, -42, f"Ø{d.BORE:g}")
    section = sheet.section(part, "y", (205, 95), "section", 18)
    section.vertical((d.FLANGE_CENTRING - d.FIT) / 2, 0.0, d.SLEEVE_LENGTH, 8)
    half = (d.FLANGE_CENTRING - d.FIT) / 2
    section.horizontal(-half, half, 0.0, -10, f"Ø{2 * half:g} into {d.FLANGE_CENTRING:g} H7")
