"""The turn of a downward tool after which its fingers close on the sides of an object.

Angles in rad, anticlockwise seen from above; lengths in m. A line through two fingers is the same after half a turn.
"""

from __future__ import annotations

import math

import numpy as np

from rig_simulation.world.scene import Cuboid, SceneObject

WIDEST = 0.1
"""Longest side that fits between the fingers."""


def heading(R_base_tool: np.ndarray) -> float:
    """Returns the direction of the tool's x axis from above, along which the fingers close.

    Args:
        R_base_tool: orientation of the tool, shape (3, 3).
    """
    return math.atan2(R_base_tool[1, 0], R_base_tool[0, 0])


def wrapped(angle: float, period: float = 2.0 * math.pi) -> float:
    """Returns the angle within plus and minus half of the period."""
    return (angle + period / 2.0) % period - period / 2.0


def turn_to(shape: SceneObject, R_base_object: np.ndarray, fingers: float) -> float:
    """Returns the smallest turn after which the fingers close along a side that fits; 0 for a round object.

    Args:
        shape: the object, which stands upright.
        R_base_object: its orientation, shape (3, 3).
        fingers: direction along which they close.
    """
    if not isinstance(shape, Cuboid):
        return 0.0
    sides = shape.size[:2]
    fitting = [axis for axis in (0, 1) if sides[axis] <= WIDEST] or [int(np.argmin(sides))]
    turns = [wrapped(math.atan2(R_base_object[1, axis], R_base_object[0, axis]) - fingers, math.pi) for axis in fitting]
    return min(turns, key=abs)
