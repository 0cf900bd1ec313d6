"""Contact forces of the world as arrows and as one label for each pair of bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.poses import read_only

METRES_PER_NEWTON = 0.03
LONGEST_M = 0.25
LEAST_N = 0.02
ROBOT = ("kuka/", "reflex/", "panel")


@dataclass(frozen=True)
class Arrow:
    """A force on a body.

    Attributes:
        tail, tip: shape (3,) [m] in the world; the tip is where the force acts.
        by_robot: whether the robot is one of the two bodies.
    """

    tail: np.ndarray
    tip: np.ndarray
    by_robot: bool


@dataclass(frozen=True)
class PairForce:
    """What all contacts of two bodies bear together.

    Attributes:
        bodies: their names; the force acts on the first.
        place: where it acts, shape (3,) [m] in the world: the mean of the contacts, weighted by their forces.
        newtons: sum of the forces along the normals [N].
        by_robot: as in Arrow.
    """

    bodies: tuple[str, str]
    place: np.ndarray
    newtons: float
    by_robot: bool


def arrows(contacts: Sequence[Mapping[str, Any]]) -> list[Arrow]:
    """Returns an arrow for each contact that the world's control port lists."""
    found = []
    for contact in contacts:
        if contact["force"] < LEAST_N:
            continue
        bodies, sign = _on_first(contact["bodies"])
        tip = np.array(contact["position"])
        length = min(METRES_PER_NEWTON * contact["force"], LONGEST_M)
        tail = tip - sign * length * np.array(contact["normal"])
        found.append(Arrow(read_only(tail), read_only(tip), _by_robot(bodies)))
    return found


def pair_forces(contacts: Sequence[Mapping[str, Any]]) -> list[PairForce]:
    """Returns the forces of pairs of bodies, in the order of their names."""
    pairs: dict[tuple[str, str], list[tuple[float, np.ndarray]]] = {}
    for contact in contacts:
        bodies, _ = _on_first(contact["bodies"])
        pairs.setdefault(bodies, []).append((contact["force"], np.array(contact["position"])))
    found = []
    for bodies, acting in sorted(pairs.items()):
        total = sum(force for force, _ in acting)
        if total >= LEAST_N:
            place = sum(force * position for force, position in acting) / total
            found.append(PairForce(bodies, read_only(place), total, _by_robot(bodies)))
    return found


def short(body: str) -> str:
    """Returns the name of a body as people read it: without the group that it belongs to."""
    return body.partition("/")[2] or body


def _on_first(bodies: Sequence[str]) -> tuple[tuple[str, str], float]:
    """Returns the pair with the body first that the force is shown on, an object before others, and its sign."""
    first, second = bodies
    if first.startswith("object/") and not second.startswith("object/"):
        return (first, second), -1.0
    return (second, first), 1.0


def _by_robot(bodies: Sequence[str]) -> bool:
    return any(body.startswith(ROBOT) for body in bodies)
