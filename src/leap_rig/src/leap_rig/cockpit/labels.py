"""Where the labels of a scene stand, so that none covers another. Pixels from the upper left corner of the view."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from leap_rig.cockpit.frame_poses import turned

LETTER_PX, LINE_PX, EDGE_PX = 6.5, 17.0, 3.0  # of the labels that viser draws
ANCHORS = {
    "bottom-center": (-0.5, -1.0), "bottom-left": (0.0, -1.0), "bottom-right": (-1.0, -1.0), "top-left": (0.0, 0.0),
    "top-right": (-1.0, 0.0), "top-center": (-0.5, 0.0), "center-left": (0.0, -0.5), "center-right": (-1.0, -0.5),
}  # fmt: skip
"""Which part of a label is at its point, the preferred one first: where its upper left corner is, in label sizes."""
INSET, LEAST_INSET_PX, INSET_LINE_PX = 0.28, 130.0, 32.0
"""Of the camera's image in the lower right corner: its width over the view's, at least so many pixels; 4 by 3 below a
line."""


@dataclass(frozen=True)
class Eye:
    """The camera of a page: position [m], orientation as a quaternion x, y, z, w, which turns z forward and y down,
    upright angle of view [rad], and size of the view in pixels."""

    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]
    fov: float
    width: float
    height: float

    def pixel(self, point: tuple[float, float, float]) -> tuple[float, float] | None:
        """Returns where a point is seen; None behind the eye."""
        i, j, k, w = self.orientation
        away = tuple(p - q for p, q in zip(point, self.position))
        x, y, z = turned((-i, -j, -k, w), away)
        nearest = 1e-3
        if z < nearest:
            return None
        scale = 0.5 * self.height / math.tan(0.5 * self.fov) / z
        return 0.5 * self.width + scale * x, 0.5 * self.height + scale * y


class Label(NamedTuple):
    key: Hashable
    text: str
    point: tuple[float, float, float]  # in the scene [m]


def anchors(labels: Iterable[Label], eye: Eye, inset: bool = False) -> dict[Hashable, str]:
    """Returns for each label that can be shown which part of it is to be at its point, a key of ANCHORS. Earlier labels
    come first; one that fits nowhere is left out. `inset`: a camera's image is in the lower right corner."""
    wide = max(INSET * eye.width, LEAST_INSET_PX)
    corner = eye.width - wide, eye.height - 0.75 * wide - INSET_LINE_PX, eye.width, eye.height
    taken = [corner] if inset else []
    found: dict[Hashable, str] = {}
    for label in labels:
        pixel = eye.pixel(label.point)
        if pixel is None:
            continue
        lines = label.text.split("\n")
        width = max(map(len, lines)) * LETTER_PX + 2 * EDGE_PX
        height = len(lines) * LINE_PX + 2 * EDGE_PX
        for anchor, (right, down) in ANCHORS.items():
            left, top = pixel[0] + right * width, pixel[1] + down * height
            box = left, top, left + width, top + height
            inside = left >= 0 and top >= 0 and box[2] <= eye.width and box[3] <= eye.height
            if inside and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                found[label.key] = anchor
                break
    return found


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
