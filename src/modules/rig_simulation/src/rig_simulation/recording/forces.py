"""Contact forces of the world: one arrow and one label for each pair of bodies, whatever number of contacts they have.

An arrow lies where it can be seen. The robot's forces have their tips where they act and stand out of its fingers; all
others begin where they act, so that what a table bears rises out of the object and does not hide under the table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.poses import read_only

METRES_PER_NEWTON = 0.06
LONGEST_M = 0.3
LEAST_N = 0.02
ROBOT = ("kuka/", "reflex/", "panel")


@dataclass(frozen=True)
class Arrow:
    """What all contacts of two bodies bear together, as an arrow in the direction in which it acts on the first.

    Attributes:
        tail, tip: shape (3,) [m] in the world.
        by_robot: whether the robot is one of the two bodies; then the force acts at the tip, else at the tail.
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
        force: their vector sum, on the first body, shape (3,) [N].
        by_robot: as in Arrow.
    """

    bodies: tuple[str, str]
    place: np.ndarray
    newtons: float
    force: np.ndarray
    by_robot: bool


def arrows(pairs: Sequence[PairForce]) -> list[Arrow]:
    """Returns the arrows of forces; those that cancel each other have none."""
    found = []
    for pair in pairs:
        newtons = float(np.linalg.norm(pair.force))
        if newtons < LEAST_N:
            continue
        way = min(METRES_PER_NEWTON, LONGEST_M / newtons) * pair.force
        tail = pair.place - way if pair.by_robot else pair.place
        found.append(Arrow(read_only(tail), read_only(tail + way), pair.by_robot))
    return found


def pair_forces(contacts: Sequence[Mapping[str, Any]]) -> list[PairForce]:
    """Returns the forces of pairs of bodies, of all contacts that the world's control port lists, in order of names."""
    pairs: dict[tuple[str, str], list[tuple[float, np.ndarray, np.ndarray]]] = {}
    for contact in contacts:
        bodies, sign = _on_first(contact["bodies"])
        newtons, normal = contact["force"], np.array(contact["normal"])
        acting = (newtons, np.array(contact["position"]), sign * newtons * normal)
        pairs.setdefault(bodies, []).append(acting)
    found = []
    for bodies, all_acting in sorted(pairs.items()):
        total = sum(newtons for newtons, _, _ in all_acting)
        if total >= LEAST_N:
            place = np.sum([newtons * position for newtons, position, _ in all_acting], axis=0) / total
            force = np.sum([force for _, _, force in all_acting], axis=0)
            found.append(PairForce(bodies, read_only(place), total, read_only(force), _by_robot(bodies)))
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
