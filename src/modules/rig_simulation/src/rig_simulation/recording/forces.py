"""Contact forces of the world: one arrow and one label for each pair of bodies, for all their contacts together.

Arrows are placed where they are visible: forces of the robot end where they act, outside its fingers; all others start
there, so that the force of a table rises out of the object.
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
    """The total force of all contacts of two bodies, as an arrow in its direction on the first body."""

    tail: np.ndarray  # shape (3,) [m] in the world
    tip: np.ndarray  # shape (3,) [m] in the world
    by_robot: bool  # whether one body is the robot; then the force acts at the tip, else at the tail


@dataclass(frozen=True)
class PairForce:
    """The total force of all contacts of two bodies."""

    bodies: tuple[str, str]  # their names; the force acts on the first
    position: np.ndarray  # mean of the contacts, weighted by their forces, shape (3,) [m] in the world
    newtons: float  # sum of the forces along the normals [N]
    force: np.ndarray  # their vector sum, on the first body, shape (3,) [N]
    by_robot: bool  # as in Arrow


def arrows(pairs: Sequence[PairForce]) -> list[Arrow]:
    """Returns the arrows of forces; forces that cancel each other have none."""
    found = []
    for pair in pairs:
        newtons = float(np.linalg.norm(pair.force))
        if newtons < LEAST_N:
            continue
        arrow = min(METRES_PER_NEWTON, LONGEST_M / newtons) * pair.force
        tail = pair.position - arrow if pair.by_robot else pair.position
        found.append(Arrow(read_only(tail), read_only(tail + arrow), pair.by_robot))
    return found


def pair_forces(contacts: Sequence[Mapping[str, Any]]) -> list[PairForce]:
    """Returns the forces of pairs of bodies, sorted by names, from the contacts of the world's control port."""
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
            centre = np.sum([newtons * position for newtons, position, _ in all_acting], axis=0) / total
            force = np.sum([force for _, _, force in all_acting], axis=0)
            found.append(PairForce(bodies, read_only(centre), total, read_only(force), _by_robot(bodies)))
    return found


def short(body: str) -> str:
    """Returns the name of a body without its group."""
    return body.partition("/")[2] or body


def _on_first(bodies: Sequence[str]) -> tuple[tuple[str, str], float]:
    """Returns the pair in the order of display, an object first, and the sign of the force on the first body."""
    first, second = bodies
    if first.startswith("object/") and not second.startswith("object/"):
        return (first, second), -1.0
    return (second, first), 1.0


def _by_robot(bodies: Sequence[str]) -> bool:
    return any(body.startswith(ROBOT) for body in bodies)
