"""The operator moves the tool farther than the hand reaches: strokes to one side, and back with the clutch pressed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.teleop_record import CLUTCHED, RUNNING
from rig_simulation.operator.pick_and_place import PickStep
from rig_simulation.operator.steering import Move

STROKES, REACH_M = 3, 0.08  # as far as the hand moves comfortably
MOVE_S = 1.5


@dataclass(frozen=True)
class ClutchStep(PickStep):
    """Result of a cycle; `clutch`: press or release it now, None: neither."""

    clutch: bool | None = None


class Clutching:
    """The operator at work; call `step` about ten times a second.

    Attributes:
        clutched: times that the clutch was pressed.
        engagement_step: farthest that the tool was from its place after an engagement [m].
        travel: distance of the tool from where it started [m]."""

    STEPS = ("wait", *("reach", "clutch", "back", "release") * STROKES, "done")

    def __init__(self) -> None:
        self.clutched, self.engagement_step, self.travel = 0, 0.0, 0.0
        self._index = 0
        self._since: float | None = None
        self._begun, self._before = np.zeros(3), np.zeros(3)

    def step(self, grip: np.ndarray, state: str, following: bool, now: float) -> ClutchStep:
        """Takes the tool's position, shape (3,) [m], the state of leap_kuka and whether the arm follows; returns what
        to do at the time `now` [s]."""
        settle_s = 0.8
        patience_s = 20.0
        name = self.STEPS[self._index]
        self._since = now if self._since is None else self._since
        waited, expected = now - self._since, CLUTCHED if name in ("clutch", "back") else RUNNING
        if name == "done":
            return ClutchStep(name)
        if waited > patience_s:
            return ClutchStep(name, failure=f"leap_kuka is {state!r} and not {expected!r} after {patience_s:g} s")
        moved = MOVE_S if name in ("reach", "back") else 0.0
        if state != expected or not following or waited < moved + settle_s:
            return ClutchStep(name)
        if name == "wait":
            self._begun = grip
        elif name == "release":
            self.engagement_step = max(self.engagement_step, float(np.linalg.norm(grip - self._before)))
        self.travel = float(np.linalg.norm(grip - self._begun))
        self._index, self._since = self._index + 1, now
        return self._begin(self.STEPS[self._index], grip)

    def _begin(self, name: str, grip: np.ndarray) -> ClutchStep:
        if name in ("reach", "back"):
            palm = np.array([REACH_M if name == "reach" else 0.0, 0.0, 0.0])
            return ClutchStep(name, Move(palm, 0.0, 0.0, MOVE_S))
        if name == "clutch":
            self.clutched += 1
            return ClutchStep(name, clutch=True)
        self._before = grip
        return ClutchStep(name, clutch=False if name == "release" else None)
