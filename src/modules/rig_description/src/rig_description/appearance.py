"""Colours, and the plain pieces of which the description's look is made beside its meshes."""

from __future__ import annotations

from dataclasses import dataclass

WHITE = (0.86, 0.87, 0.88)
GREY = (0.45, 0.47, 0.49)
DARK = (0.13, 0.13, 0.14)
ORANGE = (1.0, 0.36, 0.0)
TABLE = (0.82, 0.84, 0.87)
SHELL = (0.1, 0.1, 0.1)
LINK = (0.16, 0.16, 0.16)
FLEXURE = (0.2, 0.2, 0.2)
PAD = (0.106, 0.227, 0.631)

COLOUR_NAMES = {
    WHITE: "white",
    GREY: "grey",
    DARK: "dark",
    ORANGE: "orange",
    TABLE: "table",
    SHELL: "shell",
    LINK: "link",
    FLEXURE: "flexure",
    PAD: "pad",
}


@dataclass(frozen=True)
class Disc:
    """A cylinder of one colour."""

    colour: tuple[float, float, float]  # red, green, blue from 0 to 1
    radius: float  # [mm]
    bottom: tuple[float, float, float]  # centre of its lower face [mm]
    top: tuple[float, float, float]  # centre of its upper face [mm]
