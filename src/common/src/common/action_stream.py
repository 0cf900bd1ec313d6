"""What a program that steers wants at a moment: its newest chunk of actions, interpolated in time; a chunk that follows
another is faded in. Times [s] are of one clock, lengths in metres, angles in radians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.poses import check_pose, pose
from common.rotations import scaled_rotation

MOST_ACTIONS = 200
LONGEST_S = 2.0  # a program that is gone brings the tool no further
PERIODS_S = 0.005, 1.0
MAX_AHEAD_S = 0.5  # a chunk may begin so much later than now
FADE_S = 0.1


@dataclass(frozen=True)
class ActionChunk:
    """n actions, one each `period` from `start` on; the last one holds for a period as well."""

    start: float
    period: float
    T_base_tool: np.ndarray  # shape (n, 4, 4)
    fingers: np.ndarray  # commands of the hand, shape (n, m); m = 0: they stay

    @property
    def end(self) -> float:
        return self.start + len(self.T_base_tool) * self.period


@dataclass(frozen=True)
class PolicyAction:
    T_base_tool: np.ndarray  # shape (4, 4)
    fingers: np.ndarray  # shape (m,)


class ActionStream:
    """Takes chunks, and says which action holds."""

    def __init__(self) -> None:
        self._chunk: ActionChunk | None = None
        self._before: PolicyAction | None = None  # what held when the chunk came; it is faded out
        self._taken_at = 0.0

    def clear(self) -> None:
        self._chunk = self._before = None

    def take(self, chunk: ActionChunk, now: float) -> None:
        """Replaces what was to come by a chunk that `check_chunk` has passed."""
        self._before = self.at(now)
        self._chunk, self._taken_at = chunk, now

    def at(self, now: float) -> PolicyAction | None:
        """Returns the action that holds; None if no chunk does."""
        if self._chunk is None or now >= self._chunk.end:
            return None
        new = _at(self._chunk, now)
        w = (now - self._taken_at) / FADE_S
        return new if self._before is None or w >= 1.0 else _between(self._before, new, max(w, 0.0))


def check_chunk(chunk: ActionChunk, fingers: int, now: float) -> None:
    """Raises ValueError with the reason why a chunk is not taken `now`, a part of a sentence; `fingers`: commands of
    the hand, if it has any."""
    n, period = len(chunk.T_base_tool), chunk.period
    low, high = PERIODS_S
    if not 0 < n <= MOST_ACTIONS:
        raise ValueError(f"it has {n} actions, and 1 to {MOST_ACTIONS} are possible")
    if not low <= period <= high:
        raise ValueError(f"its period is {period:g} s and must be {low:g} to {high:g} s")
    if n * period > LONGEST_S:
        raise ValueError(f"it lasts {n * period:.1f} s, and at most {LONGEST_S:g} s are possible")
    if not now < chunk.end:
        raise ValueError(f"it came {now - chunk.end:.2f} s after its end")
    if not chunk.start - now <= MAX_AHEAD_S:
        raise ValueError(f"it begins in {chunk.start - now:.2f} s, and at most {MAX_AHEAD_S:g} s are possible")
    if chunk.fingers.shape not in ((n, 0), (n, fingers)):
        raise ValueError(f"it has {chunk.fingers.size} finger commands, and {fingers} for each action are needed")
    if not np.isfinite(chunk.fingers).all():
        raise ValueError("a finger's command is not a finite number")
    for T in chunk.T_base_tool:
        check_pose(T)


def _at(chunk: ActionChunk, now: float) -> PolicyAction:
    i = min(max((now - chunk.start) / chunk.period, 0.0), len(chunk.T_base_tool) - 1.0)
    first = int(i)
    last = min(first + 1, len(chunk.T_base_tool) - 1)
    one, other = (PolicyAction(chunk.T_base_tool[k], chunk.fingers[k]) for k in (first, last))
    return _between(one, other, i - first)


def _between(one: PolicyAction, other: PolicyAction, w: float) -> PolicyAction:
    R, p = one.T_base_tool[:3, :3], one.T_base_tool[:3, 3]
    R_step = scaled_rotation(R.T @ other.T_base_tool[:3, :3], w)
    fingers = other.fingers
    if one.fingers.shape == fingers.shape:
        fingers = (1.0 - w) * one.fingers + w * fingers
    return PolicyAction(pose(R @ R_step, (1.0 - w) * p + w * other.T_base_tool[:3, 3]), fingers)
