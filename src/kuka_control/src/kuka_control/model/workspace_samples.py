"""Random positions: all around the workspace, to see how they are constrained, and evenly within its volume.

Base frame, metres. The random numbers come from the generator that is handed in, so equal seeds give equal samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.poses import read_only
from kuka_control.model.workspace import Infeasible, Workspace

SEVERAL = "several bounds"
UNCHANGED = "inside, unchanged"


@dataclass(frozen=True, eq=False)
class ConstrainedSamples:
    """Raw positions, and what the workspace makes of them.

    Attributes:
        raw: those that can be constrained, shape (n, 3) [m].
        position: what the workspace leaves of each, shape (n, 3) [m].
        acted: for each which bound acted: its name, `SEVERAL` or `UNCHANGED`.
        infeasible: the raw positions that no workspace is for, shape (m, 3) [m].
    """

    raw: np.ndarray
    position: np.ndarray
    acted: tuple[str, ...]
    infeasible: np.ndarray

    def group(self, acted: str) -> np.ndarray:
        """Returns which samples the bound `acted` acted on alone, shape (n,) of bool."""
        return np.array([name == acted for name in self.acted], dtype=bool)


def constrained_samples(
    workspace: Workspace, count: int, random: np.random.Generator, margin: float = 0.12
) -> ConstrainedSamples:
    """Returns `count` positions in and around the workspace, constrained to it.

    Args:
        workspace: the workspace.
        count: number of raw positions.
        random: where the random numbers come from.
        margin: the positions lie up to so far beyond each bound [m].
    """
    raw, position, acted, infeasible = [], [], [], []
    for _ in range(count):
        sample = _around(workspace, random, margin)
        result = workspace.constrain(sample)
        if isinstance(result, Infeasible):
            infeasible.append(sample)
            continue
        raw.append(sample)
        position.append(result.position)
        names = [bound.value for bound in result.bounds]
        acted.append(UNCHANGED if not names else names[0] if len(names) == 1 else SEVERAL)
    return ConstrainedSamples(_rows(raw), _rows(position), tuple(acted), _rows(infeasible))


def volume_samples(workspace: Workspace, count: int, random: np.random.Generator) -> np.ndarray:
    """Returns positions spread evenly over the volume of the workspace, shape (count, 3) [m]."""
    widest = max(workspace.radii(z)[1] for z in _heights(workspace))
    half = workspace.opening_angle / 2.0
    found: list[tuple[float, float, float]] = []
    while len(found) < count:
        z = random.uniform(workspace.z_lower, workspace.z_upper)
        # Evenly over a disc: its area grows with the square of the radius.
        r = widest * math.sqrt(random.uniform())
        turn = workspace.heading + random.uniform(-half, half)
        r_inner, r_outer = workspace.radii(z)
        if r_inner <= r <= r_outer:
            found.append((r * math.cos(turn), r * math.sin(turn), z))
    return _rows(found)


def _around(workspace: Workspace, random: np.random.Generator, margin: float) -> np.ndarray:
    """Returns a position in the workspace or up to `margin` beyond it, shape (3,) [m]."""
    z = random.uniform(workspace.z_lower - margin, workspace.z_upper + margin)
    r_inner, r_outer = workspace.radii(min(max(z, workspace.z_lower), workspace.z_upper))
    r = random.uniform(max(r_inner - margin, 0.0), r_outer + margin)
    half = workspace.opening_angle / 2.0 + margin / max(r, margin)
    turn = workspace.heading + random.uniform(-half, half)
    return np.array([r * math.cos(turn), r * math.sin(turn), z])


def _heights(workspace: Workspace) -> list[float]:
    """Returns the heights at which the radii have their extremes: both limits, and joint 2 where it lies between."""
    level = min(max(workspace.joint_2_height, workspace.z_lower), workspace.z_upper)
    return [workspace.z_lower, level, workspace.z_upper]


def _rows(points: list) -> np.ndarray:
    return read_only(np.reshape(points, (-1, 3)))
