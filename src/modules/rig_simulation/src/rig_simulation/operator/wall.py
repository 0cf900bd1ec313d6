"""The operator steers the tool against a wall of objects, along it and back: what the collision guard is for. Pure:
observations in, moves of the hand out. Positions in metres in `kuka/base_frame`, times in seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rig_simulation.operator.pick_and_place import PickStep
from rig_simulation.operator.steering import Move

MOVES = (
    ("against the wall", (0.30, 0.0, 0.0), 0.0, 4.0),
    ("hold", (0.30, 0.0, 0.0), 0.0, 2.0),
    ("along", (0.30, 0.0, -0.06), 0.0, 2.0),
    ("back", (0.0, 0.0, 0.0), 0.0, 4.0),
    ("fingers", (0.0, 0.0, 0.0), 0.6, 1.5),
)
"""Name, where the palm goes: right, up and back from its entry [m], curl of the fingers, and in what time [s]."""
PATIENCE_S = 30.0


@dataclass(frozen=True)
class WallView:
    """The operator's observation: the tool's gripping point, shape (3,), and what `kuka/guard` says."""

    grip: np.ndarray
    following: bool
    distance: float
    margin: float
    scale: float


class WallVisit:
    """The operator at work; call `step` about ten times a second.

    Attributes:
        smallest: smallest distance so far, while the arm followed [m].
        held: how long the guard held the arm [s]."""

    def __init__(self) -> None:
        self.smallest, self.held = float("inf"), 0.0
        self._start: np.ndarray | None = None
        self._began: float | None = None
        self._before: float | None = None
        self._next, self._due = 0, 0.0

    def step(self, view: WallView, now: float) -> PickStep:
        """Takes an observation at the time `now` [s]; returns what to do."""
        held = 0.5  # scale of the speed below which the guard holds the arm
        self._began = now if self._began is None else self._began
        passed, self._before = now - (self._before or now), now
        if view.following:
            self.smallest = min(self.smallest, view.distance)
            self.held += passed * (view.scale < held)
        if self._start is None:
            if not view.following:
                late = now - self._began > PATIENCE_S
                return PickStep("wait", failure=f"the arm did not follow within {PATIENCE_S:g} s" if late else "")
            self._start = view.grip
        if now < self._due:
            return PickStep(MOVES[self._next - 1][0])
        if self._next == len(MOVES):
            failure = self._failure(view)
            return PickStep("back" if failure else "done", failure=failure)
        name, palm, curl, seconds = MOVES[self._next]
        self._next, self._due = self._next + 1, now + seconds
        return PickStep(name, Move(np.array(palm), 0.0, curl, seconds - 0.3))

    def _failure(self, view: WallView) -> str:
        near_m = 0.02  # so near its start the tool has come back
        allowed_m = 0.002  # measured joints may be within the margin by this: drives follow their goals unevenly
        assert self._start is not None
        off = float(np.linalg.norm(view.grip - self._start))
        if self.smallest < view.margin - allowed_m:
            return f"the robot came within {1e3 * self.smallest:.0f} mm of a body instead of {1e3 * view.margin:.0f} mm"
        if self.held == 0.0:
            return "the collision guard did not act"
        if off > near_m:
            return f"the arm did not take the way back; the tool stayed {1e3 * off:.0f} mm off"
        return ""
