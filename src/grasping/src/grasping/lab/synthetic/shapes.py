"""Random objects for the grasp networks: families of shapes put together from MuJoCo's primitives.

`TRAINING` families are what a network is trained on; `HELD_OUT` ones it meets in its evaluation only, and `UNSEEN` ones
in another one; the weights page has results of both. Every shape has a side that a parallel gripper of about 0.1 m can
span. Lengths in metres, frame of the object.
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


def banana(rng: np.random.Generator) -> Shape:
    """A bent rod of six pieces that is thick in its middle and thin at its ends."""
    radius, bend, thick = rng.uniform(0.06, 0.1), rng.uniform(1.1, 1.7), rng.uniform(0.013, 0.019)
    angles = bend * np.linspace(-0.5, 0.5, 7)
    joints = radius * np.stack([np.sin(angles), np.cos(angles) - np.cos(0.25 * bend)], axis=1)
    pieces = []
    for k, (a, b) in enumerate(zip(joints, joints[1:])):
        size = thick * (1.0 - 0.45 * (abs(k - 2.5) / 2.5) ** 2), 0.5 * float(np.linalg.norm(b - a))
        turn = -0.5 * (angles[k] + angles[k + 1])
        # A capsule lies along its z axis: first along x, then turned about z.
        lying = (np.sqrt(0.5) * np.array([np.cos(0.5 * turn), np.sin(0.5 * turn)])).tolist()
        x, y = (0.5 * (a + b)).tolist()
        pieces.append(Geom("capsule", size, (x, y, 0.0), (lying[0], -lying[1], lying[0], lying[1])))
    return tuple(pieces)


def wineglass(rng: np.random.Generator) -> Shape:
    """A hollow bowl with a round bottom on a stem and a foot."""
    r, h, stem = rng.uniform(0.026, 0.038), rng.uniform(0.018, 0.028), rng.uniform(0.02, 0.034)
    foot, thin, belly = rng.uniform(0.8, 1.0) * r, rng.uniform(0.004, 0.006), 0.6 * r
    parts = [Geom("cylinder", (foot, 0.003), (0.0, 0.0, 0.003 - 2.0 * stem))]
    parts.append(Geom("cylinder", (thin, stem), (0.0, 0.0, -stem)))
    parts.append(Geom("ellipsoid", (r, r, belly), (0.0, 0.0, 0.9 * belly)))
    return _moved((*parts, *_moved(_wall(r, 0.003, h), (0.0, 0.0, 0.9 * belly + h))), (0.0, 0.0, 0.5 * stem - 0.01))


def spanner(rng: np.random.Generator) -> Shape:
    """A flat bar with an open jaw at one end and a ring at the other."""
    half, w, h = rng.uniform(0.035, 0.05), rng.uniform(0.007, 0.011), rng.uniform(0.007, 0.011)
    jaw, ring = rng.uniform(0.014, 0.019), rng.uniform(0.014, 0.02)
    prongs = [Geom("box", (0.013, 0.0045, h), (half + jaw, side * (jaw - 0.0045), 0.0)) for side in (-1.0, 1.0)]
    parts = Geom("box", (half, w, h)), Geom("box", (0.006, jaw, h), (half, 0.0, 0.0)), *prongs
    return (*parts, *_moved(_wall(ring, 0.005, h, 8), (-half - ring, 0.0, 0.0)))


def scissors(rng: np.random.Generator) -> Shape:
    """Two blades across each other, each with a ring for a finger."""
    opened, h, w = rng.uniform(0.15, 0.35), rng.uniform(0.007, 0.01), rng.uniform(0.006, 0.009)
    blade, grip, ring = rng.uniform(0.035, 0.05), rng.uniform(0.02, 0.03), rng.uniform(0.014, 0.019)
    parts: list[Geom] = []
    for side in (-1.0, 1.0):
        c, s = np.cos(side * opened), np.sin(side * opened)
        turn = (np.cos(0.5 * side * opened), 0.0, 0.0, np.sin(0.5 * side * opened))
        middle, half = 0.5 * (blade - grip), 0.5 * (blade + grip)
        parts.append(Geom("box", (half, w, h), (c * middle, s * middle, 0.0), turn))
        # The ring lies outwards of the shank's end, which is inside its wall.
        out = grip + 0.8 * ring
        centre = -c * out - side * s * 0.5 * ring, -s * out + side * c * -0.5 * ring, 0.0
        parts += _moved(_wall(ring, 0.0045, h, 8), centre)
    return tuple(parts)


def star(rng: np.random.Generator) -> Shape:
    """A flat star of four to six blunt arms."""
    n, outer, half = int(rng.integers(4, 7)), rng.uniform(0.04, 0.06), rng.uniform(0.009, 0.022)
    inner, blunt = rng.uniform(0.38, 0.48) * outer, rng.uniform(0.35, 0.6)
    wide = inner * np.sin(np.pi / n)
    root, tip = inner * np.cos(np.pi / n), blunt * wide
    outline = [(0.0, 0.0), (root, -wide), (outer, -tip), (outer, tip), (root, wide)]
    arms = []
    for angle in 2.0 * np.pi * np.arange(n) / n:
        c, s = np.cos(angle), np.sin(angle)
        arms.append(_hull([(c * x - s * y, s * x + c * y, z) for x, y in outline for z in (-half, half)]))
    return tuple(arms)


def spray_bottle(rng: np.random.Generator) -> Shape:
    """An oval body with shoulders, a thin neck, a head with its nozzle to one side, and a trigger."""
    a, b, h = rng.uniform(0.026, 0.036), rng.uniform(0.018, 0.026), rng.uniform(0.025, 0.038)
    neck, head = rng.uniform(0.008, 0.011), rng.uniform(0.022, 0.032)
    angles = 2.0 * np.pi * np.arange(12) / 12.0
    oval = [(a * np.cos(t), b * np.sin(t)) for t in angles]
    body = [(x * k, y * k, z) for x, y in oval for k, z in ((1.0, -h), (1.0, 0.5 * h), (0.45, h))]
    lean = (np.cos(0.15), 0.0, np.sin(0.15), 0.0)
    parts = (
        _hull(body),
        Geom("cylinder", (neck, 0.012), (0.0, 0.0, h + 0.008)),
        Geom("box", (head, 0.009, 0.009), (0.5 * head, 0.0, h + 0.026)),
        Geom("box", (0.004, 0.005, 0.014), (0.9 * head, 0.0, h + 0.008), lean),
    )
    return _moved(parts, (0.0, 0.0, -0.015))


TRAINING = (box, cylinder, capsule, ellipsoid, angle_bracket, tee, dumb_bell, ring, bottle, union)
HELD_OUT = (mug, hammer, cross, prism)
UNSEEN = (banana, wineglass, spanner, scissors, star, spray_bottle)


def random_quaternion(rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Returns a uniformly random orientation w, x, y, z."""
    q = rng.standard_normal(4)
    return tuple(q / np.linalg.norm(q))


def _wall(radius: float, wall: float, half_height: float, pieces: int = 12) -> Shape:
    """Returns boxes in a circle; `radius` reaches to the middle of the wall."""
    side = radius * np.tan(np.pi / pieces) + 0.3 * wall
    angles = 2.0 * np.pi * np.arange(pieces) / pieces
    places = [(radius * np.cos(a), radius * np.sin(a), 0.0) for a in angles]
    turns = [(np.cos(0.5 * a), 0.0, 0.0, np.sin(0.5 * a)) for a in angles]
    return tuple(Geom("box", (wall, side, half_height), place, turn) for place, turn in zip(places, turns))


def _hull(corners: list[tuple[float, float, float]]) -> Geom:
    """Returns the convex hull of points [m]."""
    return Geom("mesh", (), vertices=tuple((float(x), float(y), float(z)) for x, y, z in corners))


def _moved(parts: Shape, by: tuple[float, float, float]) -> Shape:
    """Returns the parts displaced by `by` [m]."""
    (x, y, z), moved = by, []
    for part in parts:
        if part.kind == "mesh":
            moved.append(_hull([(a + x, b + y, c + z) for a, b, c in part.vertices]))
        else:
            a, b, c = part.position
            moved.append(part._replace(position=(a + x, b + y, c + z)))
    return tuple(moved)
