"""Colours of the pictures and their meaning; hues after the palette of M. Okabe and K. Ito for colour-blind people."""

from __future__ import annotations

from kuka_control.model.workspace import Bound
from kuka_control.model.workspace_samples import SEVERAL, UNCHANGED

WORKSPACE = "#3b82c4"
ARM = "#e8730c"
JOINT = "#3f4650"
TOOL = "#7a8490"
UNREACHED = "#c40018"
AXES = ("#d62728", "#2ca02c", "#1f5fd0")
"""Of x, y and z in a triad."""

FRACTIONS = "viridis"
"""Colour map of the fraction of orientations that are reached."""

ACTED = {
    UNCHANGED: "#a9b2bd",
    Bound.OPENING_ANGLE.value: "#009e73",
    Bound.Z_LOWER.value: "#d3609a",
    Bound.Z_UPPER.value: "#7b3fa0",
    Bound.INNER_SPHERE.value: "#45aee6",
    Bound.OUTER_SPHERE.value: "#0b4f8a",
    SEVERAL: "#e0b400",
}
"""Which bound moved a sample."""


def shaded(colour: str, factor: float) -> tuple[float, ...]:
    """Returns the colour `#rrggbb` darker (factor below 1) or lighter (above 1) as red, green, blue, 0 to 1."""
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    return tuple(min(part * factor, 1.0) for part in parts)
