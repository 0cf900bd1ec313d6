"""Answers of the arm's controller about the tool poses of grasps: requested once, kept while the pose stays."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.config import flag, integer, number
from common.rotations import rotation_angle

SILENT = "the arm's controller does not answer"
ASKED = "the arm's controller was asked"
RETRY_S = 1.0
"""An unanswered request is repeated after this time."""


@dataclass(frozen=True)
class ReachConfig:
    """How the controller is queried."""

    ask: bool = flag(doc="ask the arm's controller; false: every grasp within the limits counts as reachable")
    best: int = integer(low=1, high=20, doc="number of best grasps that the controller is asked about")
    timeout: float = number("s", above=0.0, high=60.0, doc="without an answer for this long it counts as silent")
    keep: float = number("s", above=0.0, high=600.0, doc="an answer expires after this long")
    same_distance: float = number("m", above=0.0, high=0.1, doc="an answer holds for grasps this near, and")
    same_angle: float = number("deg", above=0.0, high=45.0, doc="turned by no more than this")


class Reachability(NamedTuple):
    """Whether the arm reaches a tool pose."""

    reachable: bool  # whether the arm gets there; False while that is unknown
    reason: str  # why not, or why it is unknown; empty if it does
    refused: bool = False  # whether the controller said no


class _Entry(NamedTuple):
    T: np.ndarray
    asked: float
    answer: Reachability | None


class ReachabilityCache:
    """Keeps the answers by the number of the grasp; the client queries the controller."""

    def __init__(self, config: ReachConfig) -> None:
        self._config = config
        self._entries: dict[int, _Entry] = {}

    def wanted(self, number: int, T_base_grasp: np.ndarray, now: float) -> bool:
        """Returns whether the controller must be asked about a grasp, shape (4, 4) [m]."""
        entry = self._entries.get(number)
        if entry is None or not self._same(entry.T, T_base_grasp):
            return True
        return now - entry.asked > (RETRY_S if entry.answer is None else self._config.keep)

    def asked(self, number: int, T_base_grasp: np.ndarray, now: float) -> None:
        """Notes a request; the earlier answer about this pose holds until the new one."""
        before = self._entries.get(number)
        kept = before.answer if before is not None and self._same(before.T, T_base_grasp) else None
        self._entries[number] = _Entry(T_base_grasp, now, kept)

    def answered(self, number: int, answer: Reachability | None) -> None:
        """Notes the answer to the latest request about a grasp; None: there was none."""
        if number in self._entries:
            self._entries[number] = self._entries[number]._replace(answer=answer)

    def known(self, number: int) -> Reachability | None:
        """Returns the answer about a grasp, None where there is none yet."""
        entry = self._entries.get(number)
        return None if entry is None else entry.answer

    def keep_only(self, numbers: Collection[int]) -> None:
        """Forgets the other grasps."""
        self._entries = {n: e for n, e in self._entries.items() if n in numbers}

    def _same(self, a: np.ndarray, b: np.ndarray) -> bool:
        c = self._config
        near = np.linalg.norm(a[:3, 3] - b[:3, 3]) <= c.same_distance
        return bool(near and np.degrees(rotation_angle(a[:3, :3].T @ b[:3, :3])) <= c.same_angle)
