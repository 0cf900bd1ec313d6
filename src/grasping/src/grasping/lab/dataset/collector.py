"""Decides when an episode begins and ends: takes frames, hand, stream and proposals; returns finished grasps.

An episode begins with the operator's stream or the approach of a proposal and ends when it is known whether the closed
fingers held something; then no frame is kept until the hand opens where the next grasp will find the object.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from grasping.execution.grasp_watch import GraspWatch, GraspWatchConfig, HandMeasurement, ObservedGrasp
from grasping.lab.dataset.episode import EXECUTION, TELEOPERATION
from grasping.lab.dataset.frame_buffer import FrameBuffer, FrameBufferConfig, KeptFrame, KeptFrames, Optics

SAME_GRASP_S = 1.0  # two grasps seen nearer in time are one, seen by grasp_execution and by the watch


class Finished(NamedTuple):
    """A grasp with its result."""

    grasp: ObservedGrasp  # where and when, and whether it held
    source: str  # EXECUTION or TELEOPERATION
    frames: KeptFrames | None  # before it; None: it is no episode
    lift: float = math.nan  # probability of a lift that its proposal had; NaN where none is known


class Collector:
    """The collection: `teleop`, whether an operator's hand is followed, and `kept`, the number of frames since the
    beginning. `up` is the vertical in the base frame, shape (3,).
    """

    def __init__(self, frames: FrameBufferConfig, watch: GraspWatchConfig, up: np.ndarray) -> None:
        self._buffer, self._watch = FrameBuffer(frames), GraspWatch(watch, up)
        self._executing = False
        self._now = self._last_grasp = self._after = -math.inf
        self.teleop = False
        self.kept = 0

    @property
    def waiting(self) -> int:
        return len(self._buffer)

    def went_back(self, now: float) -> bool:
        """Takes the time [s]. Returns whether it went back, as in a recording that starts again: then all is lost."""
        back_s = 0.5  # stamps of different sources may differ by less
        back = now < self._now - back_s
        if back:
            self._buffer.clear()
            self._watch.reset()
            self._now = self._last_grasp = self._after = -math.inf
        self._now = max(self._now, now)
        return back

    def due(self, stamp: float) -> bool:
        """Returns whether an image of that time [s] may be looked at, after those before it."""
        return self._buffer.due(stamp)

    def wants(self, stamp: float, T_base_tool: np.ndarray) -> bool:
        """Returns whether a frame at that time [s] with the tool there would be kept."""
        return self._watch.empty and stamp > self._after and self._buffer.wants(stamp, T_base_tool)

    def add(self, frame: KeptFrame, optics: Optics) -> bool:
        """Keeps a frame, unless its episode is over. Returns whether those before, of another camera, were dropped."""
        if frame.stamp <= self._after:
            return False
        self.kept += 1
        return self._buffer.add(frame, optics)

    def stream(self, active: bool) -> None:
        if active and not self.teleop and not self._executing:
            self._begin()
        self.teleop = active

    def executing(self, active: bool) -> None:
        if active and not self._executing:
            self._begin()
        self._executing = active

    def hand(self, state: HandMeasurement, T_base_tool: np.ndarray, now: float) -> Finished | None:
        """Takes a state of the hand; while a proposal is executed, its outcome counts instead."""
        grasp = self._watch.step(state, T_base_tool, now)
        return None if grasp is None or self._executing else self._finish(grasp, TELEOPERATION)

    def outcome(self, grasp: ObservedGrasp, lift: float = math.nan) -> Finished | None:
        """Takes the outcome of a proposal with its probability of a `lift`; returns None if that grasp is finished
        already."""
        finished = self._finish(grasp, EXECUTION)
        return None if finished is None else finished._replace(lift=lift)

    def _begin(self) -> None:
        """Drops all earlier frames, including one that the network still processes."""
        self._buffer.clear()
        self._after = self._now

    def _finish(self, grasp: ObservedGrasp, source: str) -> Finished | None:
        if grasp.time < self._last_grasp + SAME_GRASP_S:
            return None
        self._last_grasp = self._after = grasp.time
        return Finished(grasp, source, self._buffer.take(grasp.time))
