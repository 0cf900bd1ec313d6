"""Keeps the tool point of the stream of servo goals inside the workspace: it brakes before a bound, not behind it.

The target stops dead where the workspace ends, while what follows it needs a way to stop. So each step is taken only
if the joints could still come to rest with the tool inside. Where they could not, the wish is held back as little as
that takes: first the part that carries the tool out is taken away from it, by a motion that leaves the other directions
and the attitude of the tool alone, so that the tool slides along the bound; and where that is not enough, all of it.

Nothing is done about a step that stays inside: far from all bounds the stream is the same as without a brake.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kuka_control.limits.speed_change import JointState, SpeedChange
from kuka_control.model.workspace import Workspace

SLACK_M = 1e-3
"""The way to a stop may lead out of the workspace by this much: on curved bounds it goes straight on."""

INWARD_PER_S = 40.0
"""A tool that slides along a bound is led to it with this share of its distance per second."""

HALVINGS = 5
"""How often the share of the wish that can be kept is narrowed down."""

SWEEPS = 3
"""Rounds over the bounds: what is taken away at one of them may add to another. They meet at 68 deg or more."""

DAMPING = 0.05
"""Of the pseudoinverse, in units of what the tool brakes with [m/s^2], [rad/s^2]; it matters near singular poses."""

LEAST = 1e-6
"""Share of the wanted speed that damping leaves, at least: a stretched arm has none ahead."""


class WorkspaceBrake:
    """Takes steps after which the tool can still stop inside.

    Args:
        workspace: where the tool point is to stay.
        tool_position: of the tool point, shape (3,) [m], at joints q, shape (7,) [rad].
        tool_jacobian: geometric Jacobian of the tool point, shape (6, 7), at joints q.
        acceleration: what each joint can brake with, shape (7,) [rad/s^2].
    """

    def __init__(
        self,
        workspace: Workspace,
        tool_position: Callable[[np.ndarray], np.ndarray],
        tool_jacobian: Callable[[np.ndarray], np.ndarray],
        acceleration: np.ndarray,
    ) -> None:
        self._workspace = workspace
        self._tool_position = tool_position
        self._tool_jacobian = tool_jacobian
        self._acceleration = acceleration

    def step(self, change: SpeedChange, now: JointState, wish: np.ndarray, dt: float) -> tuple[JointState, bool]:
        """Returns the joints after a step, and whether the wish was held back.

        Args:
            change: how the joints change their speed.
            now: the joints before.
            wish: speeds of the joints, shape (7,) [rad/s].
            dt: duration of the step [s].
        """
        free = change.step(now, wish, dt)
        out = self._out(change, free)
        if out <= SLACK_M:
            return free, False
        rest = np.zeros(7)
        stopping = change.step(now, rest, dt)
        # A tool that can no longer stop inside may do whatever takes it out no further than a full stop does.
        bound = max(SLACK_M, self._out(change, stopping))
        if out <= bound:
            return free, False
        along = self.along(now.q, wish)
        best = change.step(now, along, dt)
        if self._out(change, best) <= bound:
            kept, given_up = along, wish
        else:
            kept, given_up, best = rest, along, stopping
        for _ in range(HALVINGS):
            middle = 0.5 * (kept + given_up)
            tried = change.step(now, middle, dt)
            if self._out(change, tried) <= bound:
                kept, best = middle, tried
            else:
                given_up = middle
        return best, True

    def along(self, q: np.ndarray, wish: np.ndarray) -> np.ndarray:
        """Returns a wish without what carries the tool beyond a bound, joint speeds of shape (7,) [rad/s].

        Args:
            q: joints, shape (7,) [rad].
            wish: joint speeds, shape (7,) [rad/s].
        """
        position, J = self._tool_position(q), self._tool_jacobian(q)
        normals = self._workspace.outward(position)
        # In units of what each joint brakes with, so that the strong joints do most.
        strong = J * self._acceleration
        wanted = np.concatenate([normals.T, np.zeros((3, len(normals)))])
        ways = strong.T @ np.linalg.solve(strong @ strong.T + DAMPING**2 * np.eye(6), wanted)
        ways *= self._acceleration[:, None] / np.maximum(np.sum(normals.T * (strong[:3] @ ways), axis=0), LEAST)
        left = wish
        for _ in range(SWEEPS):
            for normal, way, room in zip(normals, ways.T, self._workspace.rooms(position)):
                excess = float(normal @ J[:3] @ left) - INWARD_PER_S * room
                left = left - max(excess, 0.0) * way
        # Near a singular pose that may need fast joints; none is to be faster than those of the wish.
        pace, wished = (float(np.max(np.abs(v) / self._acceleration)) for v in (left, wish))
        return left if pace <= wished else wished / pace * left

    def _out(self, change: SpeedChange, now: JointState) -> float:
        """Returns how far the tool leaves the workspace, at most, if the joints stop from now on [m]."""
        return -min(min(self._workspace.rooms(self._tool_position(q))) for q in change.stopping(now))
