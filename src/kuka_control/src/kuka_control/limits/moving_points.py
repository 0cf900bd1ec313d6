"""The points of the moving arm whose speed is limited.

They are elbow, wrist and flange, the tool point, and what else the flange carries: the finger tips, and what is mounted
or held there. They stand for the whole arm: of a rigid body the farthest point is the fastest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from iiwa_kinematics import Ball, Kinematics


class MovingPoints:
    """The points of an arm with its tool; those that the flange carries are in balls."""

    def __init__(self, kinematics: Kinematics, carried: Iterable[Ball] = ()) -> None:
        self._kinematics = kinematics
        self._q: Sequence[float] | None = None  # the joints last asked for, and the answer
        self._point: tuple[Sequence[float], Sequence[float]] = (), ()
        self.carry(carried)

    def carry(self, balls: Iterable[Ball]) -> None:
        """Takes over what the flange carries from now on, besides the tool point."""
        tool = self._kinematics.T_flange_tool[:3, 3].tolist()
        self._balls = [(*tool, 0.0), *balls]
        self._around = max(math.dist(centre, tool) + radius for *centre, radius in [(0.0,) * 4, *self._balls])
        self._q = None

    def speed(self, q: Sequence[float], v: Sequence[float]) -> float:
        """Returns the speed of the fastest point [m/s] at joints q, 7 [rad], for joint speeds v, 7 [rad/s]."""
        return self._kinematics.fastest_point(self._balls, q, v)

    def tool_point(self, q: Sequence[float]) -> tuple[Sequence[float], Sequence[float]]:
        """Returns the tool point, x, y, z [m], and how far no point is beyond from each of the 7 joint axes [m].

        At the joints q, 7 [rad]; of the same list they are calculated once.
        """
        if q is not self._q:
            self._q, self._point = q, self._kinematics.tool_point(q, self._around)
        return self._point
