"""Random objects for the grasp networks: families of shapes put together from MuJoCo's primitives.

`TRAINING` families are what a network is trained on; `HELD_OUT` ones it meets in its evaluation only. Every shape has
a side that a parallel gripper of about 0.1 m can span. Lengths in metres, frame of the object.
"""

from __future__ import annotations

from typing import NamedTuple, Tuple

import numpy as np

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
ALONG_X = (0.70710678, 0.0, 0.70710678, 0.0)  # quaternion w, x, y, z that lays a cylinder along x


class Geom(NamedTuple):
    """One primitive of an object."""

    kind: str  # MuJoCo's name of it; "mesh" is the convex hull of `vertices`
    size: tuple[float, ...]  # half sizes as MuJoCo counts them [m]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # x, y, z in the object [m]
    quaternion: tuple[float, float, float, float] = UPRIGHT  # w, x, y, z in the object
    vertices: tuple[tuple[float, float, float], ...] = ()  # corners of a mesh [m]


Shape = Tuple[Geom, ...]  # an object: its primitives in its own frame


def box(rng: np.random.Generator) -> Shape:
    return (Geom("box", (rng.uniform(0.008, 0.04), rng.uniform(0.01, 0.06), rng.uniform(0.01, 0.06))),)


def cylinder(rng: np.random.Generator) -> Shape:
    return (Geom("cylinder", (rng.uniform(0.01, 0.04), rng.uniform(0.01, 0.07))),)


def capsule(rng: np.random.Generator) -> Shape:
    return (Geom("capsule", (rng.uniform(0.009, 0.03), rng.uniform(0.01, 0.06))),)


def ellipsoid(rng: np.random.Generator) -> Shape:
    return (Geom("ellipsoid", tuple(rng.uniform(0.014, 0.042, 3))),)


def angle_bracket(rng: np.random.Generator) -> Shape:
    """Two bars that meet at their ends, an L."""
    a, b, w, h = rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.05), rng.uniform(0.008, 0.018), rng.uniform(0.01, 0.03)
    return Geom("box", (a, w, h)), Geom("box", (w, b, h), (a - w, b + w, 0.0))


def tee(rng: np.random.Generator) -> Shape:
    """Two bars, one on the middle of the other, a T."""
    a, b, w, h = rng.uniform(0.03, 0.06), rng.uniform(0.02, 0.05), rng.uniform(0.008, 0.018), rng.uniform(0.01, 0.03)
    return Geom("box", (a, w, h)), Geom("box", (w, b, h), (0.0, b + w, 0.0))


def dumb_bell(rng: np.random.Generator) -> Shape:
    bar, half, r = rng.uniform(0.008, 0.015), rng.uniform(0.025, 0.05), rng.uniform(0.02, 0.038)
    ends = [Geom("sphere", (r,), (x, 0.0, 0.0)) for x in (-half, half)]
    return (Geom("cylinder", (bar, half), (0.0, 0.0, 0.0), ALONG_X), *ends)


def ring(rng: np.random.Generator) -> Shape:
    """A flat ring of twelve pieces."""
    radius, wall, h = rng.uniform(0.03, 0.055), rng.uniform(0.006, 0.012), rng.uniform(0.008, 0.02)
    return _wall(radius, wall, h)


def bottle(rng: np.random.Generator) -> Shape:
    r, h, neck = rng.uniform(0.022, 0.038), rng.uniform(0.03, 0.06), rng.uniform(0.4, 0.6)
    return Geom("cylinder", (r, h)), Geom("cylinder", (neck * r, 0.4 * h), (0.0, 0.0, 1.4 * h))


def union(rng: np.random.Generator) -> Shape:
    """Two to four primitives stuck together anyhow."""
    geoms = []
    for _ in range(rng.integers(2, 5)):
        kind = rng.choice(["box", "cylinder", "capsule", "ellipsoid"])
        size = rng.uniform(0.008, 0.03, 3 if kind in ("box", "ellipsoid") else 2)
        position = rng.uniform(-0.025, 0.025, 3)
        geoms.append(Geom(str(kind), tuple(size), tuple(position), random_quaternion(rng)))
    return tuple(geoms)


def mug(rng: np.random.Generator) -> Shape:
    """A hollow cylinder with a floor and a handle."""
    r, h, wall = rng.uniform(0.03, 0.042), rng.uniform(0.035, 0.055), 0.0035
    grip = r + rng.uniform(0.02, 0.03)
    handle = [Geom("box", (0.5 * (grip - r), 0.005, 0.005), (0.5 * (grip + r), 0.0, z)) for z in (-0.5 * h, 0.5 * h)]
    upright = Geom("box", (0.005, 0.005, 0.5 * h + 0.005), (grip, 0.0, 0.0))
    return (*_wall(r, wall, h), Geom("cylinder", (r, 0.004), (0.0, 0.0, 0.004 - h)), *handle, upright)


def hammer(rng: np.random.Generator) -> Shape:
    half, grip, head = rng.uniform(0.05, 0.075), rng.uniform(0.009, 0.014), rng.uniform(0.025, 0.04)
    return Geom("cylinder", (grip, half), (0.0, 0.0, 0.0), ALONG_X), Geom("box", (0.014, head, 0.014), (half, 0.0, 0.0))


def cross(rng: np.random.Generator) -> Shape:
    a, b, w, h = rng.uniform(0.035, 0.06), rng.uniform(0.03, 0.06), rng.uniform(0.008, 0.018), rng.uniform(0.01, 0.025)
    return Geom("box", (a, w, h)), Geom("box", (w, b, h))


def prism(rng: np.random.Generator) -> Shape:
    """An irregular column with three to seven sides that narrows to its top."""
    n = rng.integers(3, 8)
    angle = 2.0 * np.pi * (np.arange(n) + rng.uniform(-0.25, 0.25, n)) / n
    radius, half, top = rng.uniform(0.022, 0.042), rng.uniform(0.015, 0.05), rng.uniform(0.7, 1.0)
    ground = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return (_hull([(*p, -half) for p in ground] + [(*(top * p), half) for p in ground]),)


TRAINING = (box, cylinder, capsule, ellipsoid, angle_bracket, tee, dumb_bell, ring, bottle, union)
HELD_OUT = (mug, hammer, cross, prism)


def random_quaternion(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Returns a uniformly random orientation w, x, y, z."""
    q = rng.standard_normal(4)
    return tuple(q / np.linalg.norm(q))


def _wall(radius: float, wall: float, half_height: float) -> Shape:
    """Returns twelve boxes in a circle; `radius` reaches to the middle of the wall."""
    pieces = 12
    side = radius * np.tan(np.pi / pieces) + 0.3 * wall
    angles = 2.0 * np.pi * np.arange(pieces) / pieces
    places = [(radius * np.cos(a), radius * np.sin(a), 0.0) for a in angles]
    turns = [(np.cos(0.5 * a), 0.0, 0.0, np.sin(0.5 * a)) for a in angles]
    return tuple(Geom("box", (wall, side, half_height), place, turn) for place, turn in zip(places, turns))


def _hull(corners: list[tuple[float, float, float]]) -> Geom:
    """Returns the convex hull of points [m]."""
    return Geom("mesh", (), vertices=tuple((float(x), float(y), float(z)) for x, y, z in corners))
