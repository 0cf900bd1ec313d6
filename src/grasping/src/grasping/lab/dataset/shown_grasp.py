"""The collection of 2019: many maps of a thing while the arm stands at home, then many poses of the tool at its grasp.

Of M maps and P poses, pose i makes an episode with maps i M / P to (i + 1) M / P, at least one. Its label is the
desired tool, as in 2019. All of a session show one grasp of one thing; as data they count as little more than one.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from grasping.execution.grasp_watch import ObservedGrasp
from grasping.lab.dataset.frame_buffer import KeptFrame, KeptFrames, Optics, keep

REASON = "An operator held the tool there; nothing was lifted."


class Phase(Enum):
    """What a session takes next."""

    MAPS = "maps"
    POSES = "poses"
    DONE = "done"


class SampleSchedule:
    """Which of a faster stream's samples are taken: `rate` a second [Hz], also where their times do not fit it."""

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._next: float | None = None

    def due(self, stamp: float) -> bool:
        """Returns whether a sample of that time [s] is to be taken."""
        return self._next is None or stamp >= self._next

    def take(self, stamp: float) -> None:
        """Takes a sample. One that came late lets the next one come sooner, by half a period at most."""
        scheduled = stamp if self._next is None else max(self._next, stamp - self._period / 2.0)
        self._next = scheduled + self._period


class ShownGrasp:
    """A session of `maps` and `poses`, so many a second [Hz] of each."""

    def __init__(self, maps: int, poses: int, map_rate: float, pose_rate: float) -> None:
        self._maps, self._poses = maps, poses
        self._schedules = {Phase.MAPS: SampleSchedule(map_rate), Phase.POSES: SampleSchedule(pose_rate)}
        self._rows: list[KeptFrame] = []
        self._optics: Optics | None = None
        self._pose_count = 0

    @property
    def phase(self) -> Phase:
        """What comes next."""
        if len(self._rows) < self._maps:
            return Phase.MAPS
        return Phase.POSES if self._pose_count < self._poses else Phase.DONE

    @property
    def taken(self) -> int:
        """How many of the present phase are taken; of the last one, when all are."""
        return len(self._rows) if self.phase is Phase.MAPS else self._pose_count

    def due(self, stamp: float) -> bool:
        """Returns whether a map or pose of that time [s] is to be taken."""
        return self._schedules[self.phase].due(stamp)

    def add_map(self, frame: KeptFrame, optics: Optics) -> bool:
        """Takes a map of the first phase. Returns whether those before, of another camera, were dropped."""
        changed = keep(self._rows, self._optics, frame, optics)
        self._schedules[Phase.MAPS].take(frame.stamp)
        self._optics = optics
        return changed

    def add_pose(self, stamp: float, T_base_tool: np.ndarray) -> tuple[KeptFrames, ObservedGrasp]:
        """Takes a pose of the second phase, shape (4, 4) [m], at a time [s] after the maps; returns its episode's
        frames and grasp.
        """
        if self.phase is not Phase.POSES or self._optics is None:
            raise ValueError(f"the session takes no poses: it is at its {self.phase.value}")
        first, end = (i * self._maps // self._poses for i in (self._pose_count, self._pose_count + 1))
        self._schedules[Phase.POSES].take(stamp)
        self._pose_count += 1
        rows = self._rows[first : max(end, first + 1)]
        return KeptFrames(self._optics, rows), ObservedGrasp(stamp, T_base_tool, True, REASON)
