"""The track of an object of the simulated world: whether it left the table, how high, and whether it stands again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OFF_TABLE_M = 0.01
"""An object whose lowest point is higher than this has left the table."""
ON_TABLE_M = 0.003
FELL_M = -0.02
"""Lower than the table's top: it fell beside it."""
UPRIGHT_RAD = float(np.radians(10.0))


@dataclass
class ObjectTrack:
    """One object during a run; times in seconds, lengths in metres, angles in radians."""

    lifted: float | None = None  # time at which it first left the table
    highest: float = 0.0  # greatest height of its lowest point above the table
    put_down: float | None = None  # time at which the hand released it on the table after the lift
    moved: float = 0.0  # horizontal distance from its first position
    tilt: float = 0.0  # angle between its vertical axis now and at first
    fell: bool = False  # whether it fell off the table
    _first: np.ndarray | None = None

    @property
    def picked_and_placed(self) -> bool:
        """Whether it left the table and stands on it again, upright."""
        return self.lifted is not None and self.put_down is not None and self.tilt < UPRIGHT_RAD and not self.fell

    def observe(self, T_world_object: np.ndarray, clearance: float, on_table: bool, held: bool, now: float) -> None:
        """Adds a pose, shape (4, 4), with the height of the lowest point above the table [m], and whether table and
        robot touch the object."""
        if self._first is None:
            self._first = T_world_object
        self.highest = max(self.highest, clearance)
        self.fell |= clearance < FELL_M
        self.moved = float(np.linalg.norm((T_world_object - self._first)[:2, 3]))
        up, up_first = T_world_object[:3, 2], self._first[:3, 2]
        self.tilt = float(np.arccos(np.clip(up @ up_first, -1.0, 1.0)))
        if clearance > OFF_TABLE_M:
            self.lifted = now if self.lifted is None else self.lifted
            self.put_down = None
        elif self.lifted is not None and self.put_down is None and on_table and not held and clearance < ON_TABLE_M:
            self.put_down = now
