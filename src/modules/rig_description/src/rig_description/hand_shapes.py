"""What the hand's links look like: dark links and blue rubber pads with the vendor's dimensions, no CAD data.

Millimetres, in the link's own frame.
"""

from __future__ import annotations

from rig_description.appearance import FLEXURE, GREY, LINK, PAD, SHELL, Disc
from rig_description.hand import CONNECTOR_FACES, CONNECTOR_RADIUS
from rig_description.solids import Mesh, above, below, blend, block, common_part, cut, drum, rod, surface

SWIVEL_CENTRES = ((50.4, -26.0), (50.4, 26.0))


def _shell() -> Mesh:
    foot = drum(2, -20.0, 40.0, 41.0, edge=6.0)
    rim = block((-55.0, -53.0, 34.0), (83.0, 53.0, 76.0), edge=20.0)
    thumb = block((-55.0, -24.0, 50.0), (-12.0, 24.0, 92.0), edge=7.0)
    seats = [drum(2, 62.0, 120.0, 23.0, centre, edge=1.0) for centre in SWIVEL_CENTRES]
    body = common_part(3.0, blend(30.0, foot, rim, thumb), above(2, 0.0), below(2, 92.0))
    slot = block((-90.0, -10.5, 66.0), (-18.0, 10.5, 120.0), edge=2.0)
    return surface(cut(3.0, body, slot, *seats), (-70, -70, -12), (98, 70, 106), 6.5)


def _palm() -> Mesh:
    pad = block((-16.0, -50.0, 66.0), (80.0, 50.0, 89.0), edge=9.0)
    seats = [drum(2, 40.0, 120.0, 23.5, centre, edge=1.0) for centre in SWIVEL_CENTRES]
    return surface(cut(3.0, pad, *seats), (-26, -60, 56), (92, 60, 100), 4.5)


def _swivel() -> Mesh:
    table = drum(2, 0.0, 10.0, 20.0, edge=2.0)
    cheeks = common_part(3.0, rod((8, -18, 16), (8, 18, 16), 13, 13), block((-20, -17.5, 2), (22, 17.5, 29), 3.0))
    body = blend(4.0, table, cheeks)
    return surface(cut(4.0, body, block((-40, -9, 8), (40, 9, 60), 3.0)), (-28, -26, -8), (30, 26, 38), 3.2)


def _proximal() -> Mesh:
    beam = blend(6.0, rod((0, 0, 0), (56, 0, -1), 9, 6.5), block((0, -7, -8), (60, 7, 5), 2.5))
    return surface(
        common_part(3.0, beam, block((-12, -7.5, -9), (61, 7.5, 8), 2.0)), (-18, -14, -16), (68, 14, 15), 3.2
    )


def _proximal_pad() -> Mesh:
    return surface(block((12, -8, -7), (61, 8, 14), 4.0), (6, -14, -14), (68, 14, 20), 3.2)


def _distal() -> Mesh:
    return surface(rod((12, 0, -3), (34, 0, -3), 6.5, 5), (0, -13, -16), (46, 13, 10), 2.6)


def _flexure() -> Mesh:
    return surface(block((-9, -7, -6), (13, 7, -1), 2.0), (-15, -13, -12), (19, 13, 5), 2.6)


def _distal_pad() -> Mesh:
    pad = blend(5.0, block((9, -8, -6), (40, 8, 10), 4.0), rod((34, 0, 1), (40, 0, 0), 8.5, 7.5))
    return surface(pad, (3, -15, -13), (54, 15, 17), 3.0)


MESHES = {
    "shell": (_shell, SHELL),
    "palm": (_palm, PAD),
    "swivel": (_swivel, SHELL),
    "proximal": (_proximal, LINK),
    "proximal_pad": (_proximal_pad, PAD),
    "flexure": (_flexure, FLEXURE),
    "distal": (_distal, LINK),
    "distal_pad": (_distal_pad, PAD),
}
"""Function that makes the surface, and colour, by the mesh's name."""

LOOK = {
    "base_link": ("shell", "palm"),
    "swivel": ("swivel",),
    "proximal": ("proximal", "proximal_pad"),
    "distal": ("flexure", "distal", "distal_pad"),
}
"""Meshes of each part of the hand."""


def trim(part: str) -> list[Disc]:
    """Returns the cylinders on a part: connector, knuckles."""
    if part == "base_link":
        bottom, top = (tuple(1e3 * face) for face in CONNECTOR_FACES)
        return [Disc(GREY, 1e3 * CONNECTOR_RADIUS, bottom, top)]
    if part == "proximal":
        return [Disc(FLEXURE, 5.0, (0.0, -9.5, 0.0), (0.0, 9.5, 0.0))]
    return []
