"""The printed ring of the marker board, between flange and connector (cad/marker_connector), in the flange's frame.

Lengths in m. The pad beside the hand carries the board's plate, which is not part of it. While the ring is on, the hand
stands farther from the flange by its length.
"""

from __future__ import annotations

import numpy as np

from rig_description.hand import CONNECTOR_RADIUS
from rig_description.rigid_body import Body, box, cylinder, joined

LENGTH = 0.010
FACES = np.zeros(3), np.array([0.0, 0.0, LENGTH])
"""Centres of the faces of the round part."""

PAD_FACE = 0.061
PAD = (-0.058, 0.053, 0.0), (0.058, PAD_FACE, 0.060)
ARM = (-0.035, 0.025, 0.0), (0.035, 0.053, LENGTH)
"""Opposite corners of the pad, and of what holds it."""

_MASSES = 0.065, 0.075, 0.010
"""Of ring, pad and arm [kg]: 118 cm^3 of PETG, as if solid."""


def body() -> Body:
    """Returns its mass properties in the flange's frame."""
    ring, pad, arm = _MASSES
    return joined([cylinder(ring, CONNECTOR_RADIUS, *FACES), box(pad, *PAD), box(arm, *ARM)])
