"""What the links of arm and hand look like: meshes, with rings and covers as cylinders; own shapes without CAD data.
Millimetres. The arm's cylinders are in the axes of the upright pose, origin in the link's own origin: each of links 1
to 4 starts at a seam across the arm and ends in one half of a joint's housing beside the arm's axis. The hand's are in
the link's own frame."""

from __future__ import annotations

from dataclasses import dataclass

from rig_description.arms import ArmDescription
from rig_description.hand import CONNECTOR_FACES, CONNECTOR_RADIUS

COLOURS = {
    "white": (0.86, 0.87, 0.88),
    "grey": (0.45, 0.47, 0.49),
    "dark": (0.13, 0.13, 0.14),
    "orange": (1.0, 0.36, 0.0),
    "table": (0.82, 0.84, 0.87),
    "shell": (0.1, 0.1, 0.1),
    "link": (0.16, 0.16, 0.16),
    "flexure": (0.2, 0.2, 0.2),
    "pad": (0.106, 0.227, 0.631),
}
"""Red, green, blue from 0 to 1."""


@dataclass(frozen=True)
class Disc:
    """A cylinder of one colour."""

    colour: str  # its name
    radius: float  # [mm]
    bottom: tuple[float, float, float]  # centre of its lower face [mm]
    top: tuple[float, float, float]  # centre of its upper face [mm]


RING = 9.0


def arm_trim(arm: ArmDescription, link: int) -> list[Disc]:
    """Returns the rings at the link's seams and the covers of its joint housing."""
    tube = 68.0
    housing_side = 92.0
    gap = 1.0
    collar = 20.0
    low, middle, high = (1e3 * seam for seam in arm.seams)
    shoulder, upper, fore = (1e3 * length for length in arm.lengths)
    up = {0: low, 2: middle, 4: high}.get(link)
    down = {1: low - shoulder, 3: middle - upper, 5: high - fore}.get(link)
    discs = [_across("white", 107.0, 0.0, 14.0)] if link == 0 else []
    if up is not None:
        discs += [_across("white", tube + 0.6, up - collar, up - gap), _across("grey", tube + 1.0, up - RING, up - gap)]
    if down is not None:
        discs += [_across("white", tube + 0.6, down, down + collar), _across("orange", tube + 1.0, down, down + RING)]
    if link in (1, 4):
        discs += [_aside("orange", 54.0, -housing_side - 1.5, -80.0), _aside("grey", 46.0, -housing_side - 2.5, -80.0)]
    if link in (2, 3):
        discs += [_aside("orange", 54.0, 80.0, housing_side + 1.5), _aside("grey", 46.0, 80.0, housing_side + 2.5)]
    if link == 6:
        discs += [_aside("orange", 40.0, 56.0, 66.5), _aside("grey", 36.0, 56.0, 68.0)]
    if link == 7:
        discs += [_across("dark", 46.0, 76.0, 84.0), _across("grey", 48.0, 84.0, 126.0)]
    return discs


def media_flange(name: str, height: float) -> list[Disc]:
    """Returns the look of a media flange whose outer face is the origin."""
    discs = [_across("grey", 50.0, -height, -height + 12.0), _across("dark", 49.0, -height + 12.0, -6.0)]
    if name == "MF_touch_pneumatisch":
        discs.append(_across("pad", 50.0, -24.0, -18.0))
    return [*discs, _across("grey", 50.0, -6.0, 0.0)]


def _across(colour: str, radius: float, bottom: float, top: float) -> Disc:
    return Disc(colour, radius, (0.0, 0.0, bottom), (0.0, 0.0, top))


def _aside(colour: str, radius: float, near: float, far: float) -> Disc:
    return Disc(colour, radius, (0.0, near, 0.0), (0.0, far, 0.0))


LOOK = {
    "base_link": ("shell", "palm"),
    "swivel": ("swivel",),
    "proximal": ("proximal", "proximal_pad"),
    "distal": ("flexure", "distal", "distal_pad"),
}
"""Meshes of each part of the hand."""


def hand_trim(part: str) -> list[Disc]:
    """Returns the cylinders on a part: connector, knuckles."""
    if part == "base_link":
        bottom, top = (tuple(1e3 * face) for face in CONNECTOR_FACES)
        return [Disc("grey", 1e3 * CONNECTOR_RADIUS, bottom, top)]
    if part == "proximal":
        return [Disc("flexure", 5.0, (0.0, -9.5, 0.0), (0.0, 9.5, 0.0))]
    return []
