"""Mass, centre of mass, inertia of rigid bodies: uniform solids, changes of frame and sums."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Body:
    """A rigid body in some frame."""

    mass: float  # [kg]
    com: np.ndarray  # centre of mass, shape (3,) [m]
    inertia: np.ndarray  # about the centre of mass, axes of the frame, shape (3, 3) [kg m^2]


def cylinder(mass: float, radius: float, bottom: ArrayLike, top: ArrayLike) -> Body:
    """Returns a uniform solid cylinder between the centres of its two faces, each of shape (3,) [m]."""
    bottom, top = np.asarray(bottom, dtype=float), np.asarray(top, dtype=float)
    length = np.linalg.norm(top - bottom)
    axis = (top - bottom) / length
    along, across = mass * radius**2 / 2.0, mass * (3.0 * radius**2 + length**2) / 12.0
    return Body(mass, (bottom + top) / 2.0, across * np.eye(3) + (along - across) * np.outer(axis, axis))


def box(mass: float, low: ArrayLike, high: ArrayLike) -> Body:
    """Returns a uniform solid box between two opposite corners, each of shape (3,) [m]."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    squares = (high - low) ** 2
    return Body(mass, (low + high) / 2.0, mass / 12.0 * np.diag(squares.sum() - squares))


def turned(body: Body, R: ArrayLike) -> Body:
    """Returns the body in a frame with the same origin; R: orientation of the old frame in the new, shape (3, 3)."""
    R = np.asarray(R, dtype=float)
    return Body(body.mass, R @ body.com, R @ body.inertia @ R.T)


def joined(bodies: list[Body]) -> Body:
    """Returns several bodies of the same frame as one (parallel axes)."""
    mass = sum(body.mass for body in bodies)
    com = np.sum([body.mass * body.com for body in bodies], axis=0) / mass
    inertia = np.zeros((3, 3))
    for body in bodies:
        d = body.com - com
        inertia += body.inertia + body.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return Body(mass, com, inertia)
